"""Reads the frames and the moving pictures that `srnerf-dag export exr` and `export video` wrote, by OpenImageIO and Pillow.

python frames.py IMAGES      beside half-zip, float-dwaa, parts, fly.webp ...
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from PIL import Image

images = Path(sys.argv[1])
frames = json.loads((images / "transforms.json").read_text())["frames"]


def read(path):
    """Channels by name, the header of the first part, and the names of the parts."""
    image = oiio.ImageInput.open(str(path))
    assert image, oiio.geterror()
    channels, parts, head = {}, [], None
    while image.seek_subimage(len(parts), 0):
        spec = image.spec()
        head = head or spec.copy()
        name = spec.get_string_attribute("oiio:subimagename") or spec.get_string_attribute("name")
        pixels = image.read_image(len(parts), 0, 0, spec.nchannels, oiio.FLOAT)
        assert pixels is not None, image.geterror()
        formats = list(spec.channelformats) or [spec.format] * spec.nchannels
        for i, channel in enumerate(spec.channelnames):
            full = channel if not parts or channel.startswith(f"{name}.") else f"{name}.{channel}"
            channels[full] = (pixels[..., i], str(formats[i]))
        parts.append(name)
    image.close()
    return channels, head, parts


def check_sequence(folder, first=1):
    files = sorted(Path(folder).glob("fly.*.exr"))
    assert [file.name for file in files] == [f"fly.{first + i:04}.exr" for i in range(len(frames))], files
    worst = {}
    for file, frame in zip(files, frames):
        truth, _, _ = read(images / f"{frame['name'] if 'name' in frame else Path(frame['file_path']).stem}.exr")
        ours, head, parts = read(file)
        assert sorted(ours) == sorted(["R", "G", "B", "A", "depth.Z", "N.X", "N.Y", "N.Z"]), sorted(ours)
        assert head.get_string_attribute("colorInteropID") == "lin_rec709_scene"
        assert np.allclose(head["chromaticities"], [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329])
        assert head.get_string_attribute("ImageDescription") or head.get_string_attribute("comments")
        matrix = np.array(head["worldtocamera"]).reshape(4, 4)
        pose = np.array(frame["transform_matrix"])
        # Rows of Imath are our columns; its camera looks along +z.
        expected = (np.diag([1, 1, -1, 1]) @ np.linalg.inv(pose)).T
        assert np.allclose(matrix, expected, atol=1e-5), file
        for name, ((values, kind), (exact, _)) in {
            name: (ours[name], truth["Z" if name == "depth.Z" else name]) for name in ["R", "G", "B", "A", "depth.Z"]
        }.items():
            assert kind == ("float" if name == "depth.Z" or folder.startswith("float") else "half"), (folder, name, kind)
            worst[name] = max(worst.get(name, 0), np.abs(values - exact).max() / max(1, np.abs(exact).max()))
        length = np.sqrt(sum(ours[f"N.{axis}"][0] ** 2 for axis in "XYZ"))
        assert (np.isclose(length, 1, atol=0.02) | np.isclose(length, 0, atol=0.02)).all()
    # As much as the reference encoder loses on so small and rough pictures.
    limit = 0.025 if "dwa" in folder else 5e-4 if not folder.startswith("float") else 0
    assert all(error <= limit for name, error in worst.items() if name != "depth.Z"), (folder, worst)
    assert worst["depth.Z"] == 0, (folder, worst)
    return head, parts


for folder in [f"{numbers}-{compression}" for numbers in ("half", "float") for compression in ("zip", "piz", "dwaa")]:
    check_sequence(folder)
head, parts = check_sequence("parts", 1001)
assert parts == ["rgba", "depth", "N"], parts
assert head["FramesPerSecond"] == (24000, 1001), head["FramesPerSecond"]
print(f"OpenImageIO {oiio.__version__}: {len(frames)} frames in layers and in parts, packed by zip, piz and dwaa")

clip = Image.open("fly.webp")
assert clip.n_frames == len(frames) and clip.info["loop"] == 0
for i, frame in enumerate(frames):
    clip.seek(i)
    exact, _, _ = read(images / f"{Path(frame['file_path']).stem}.exr")
    linear = exact["G"][0]
    alpha = exact["A"][0]
    straight = np.divide(linear, alpha, out=np.zeros_like(linear), where=alpha > 0)
    srgb = np.where(straight <= 0.0031308, 12.92 * straight, 1.055 * np.maximum(straight, 1e-9) ** (1 / 2.4) - 0.055)
    shown = srgb * alpha + 1 - alpha
    assert np.abs(np.array(clip.convert("RGB"))[..., 1] / 255 - shown.clip(0, 1)).max() < 0.5 / 255 + 1e-3
print(f"Pillow: an animated WebP of {clip.n_frames} frames")

for film, codec in [("fly.mp4", "h264"), ("fly.webm", "vp9")]:
    if Path(film).exists():
        asked = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json", film]
        stream = json.loads(subprocess.run(asked, check=True, capture_output=True).stdout)["streams"][0]
        assert stream["codec_name"] == codec and int(stream["nb_read_frames"]) == len(frames), stream
        assert stream["color_space"] == "bt709" and stream["r_frame_rate"] == "24/1", stream
        print(f"ffprobe: {film} is {codec} of {stream['nb_read_frames']} frames")
