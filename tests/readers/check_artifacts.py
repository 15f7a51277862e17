"""Opens the artifacts under a folder with readers that share no code with srnerf-dag, and checks what they say.

    pip install OpenEXR safetensors numpy pillow
    python check_artifacts.py FOLDER [UNET]

Every EXR is opened by `OpenEXR`, its camera compared with the frame in `transforms.json` beside it; every safetensors
by `safetensors.numpy`; every PNG and GIF by `PIL`; every JSON by `json`. With `diffusers` and `peft` there as well, LoRA weights
are loaded into a UNet: that of the embedded prior, or the one with its config.json in the folder UNET. Prints what it finds; exits with 1 if anything is wrong.
"""

import json
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import safetensors
import safetensors.numpy
from PIL import Image

PRIOR_UNET = Path(__file__).parents[2] / "stages/diffusion/models/tiny-x4/unet"

problems = []


def check(path, condition, what):
    if not condition:
        problems.append(f"{path}: {what}")


def close(left, right):
    return np.allclose(left, right, rtol=1e-4, atol=1e-4)


def project(frame, top, point):
    """A point of OpenGL camera space to fractions of the image, by transforms.json's own definition."""
    lens = {key: frame.get(key, top.get(key)) for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    x, y, z = point
    return [
        (lens["cx"] + lens["fl_x"] * x / -z) / lens["w"],
        (lens["cy"] - lens["fl_y"] * y / -z) / lens["h"],
    ]


def check_camera(path, header, frame, top):
    """Row vectors times OpenEXR's matrices: left-handed camera space, then image fractions from the upper left."""
    camera_to_world = np.array(frame["transform_matrix"])
    for point in ([0.0, 0.0, -1.0], [0.3, 0.2, -2.0], [-0.4, 0.1, -3.0]):
        world = camera_to_world @ [*point, 1.0]
        in_camera = world @ np.array(header["worldToCamera"]).reshape(4, 4)
        check(path, close(in_camera, [point[0], point[1], -point[2], 1.0]), f"worldToCamera maps {point} to {in_camera}")
        ndc = world @ np.array(header["worldToNDC"]).reshape(4, 4)
        check(path, close(ndc[:2] / ndc[3], project(frame, top, point)), f"worldToNDC maps {point} to {ndc}")
    for name in ("near", "far"):
        check(path, close(header[name], frame.get(name, top.get(name))), f"{name} is {header[name]}")


def check_image(path):
    # Without separate_channels, OpenEXR would bundle R, G and B into one array.
    part = OpenEXR.File(str(path), separate_channels=True).parts[0]
    header, channels = part.header, {name: channel.pixels for name, channel in part.channels.items()}
    print(path, {name: (pixels.shape, str(pixels.dtype)) for name, pixels in channels.items()})
    check(path, {"R", "G", "B"} <= set(channels) <= {"R", "G", "B", "A", "Z"}, f"channels are {sorted(channels)}")
    check(path, all(pixels.dtype == np.float32 for pixels in channels.values()), "channels are not all float")
    check(path, header.get("colorInteropID") == "lin_rec709_scene", "colour space is not stated")
    check(path, "stage" in json.loads(header["srnerf"]), "provenance is not JSON with a stage")
    top = json.loads((path.parent / "transforms.json").read_text())
    frames = [frame for frame in top["frames"] if frame["file_path"] == path.name]
    check(path, len(frames) == 1, f"has {len(frames)} frames in transforms.json")
    for frame in frames:
        height, width = channels["R"].shape
        check(path, (width, height) == (frame.get("w", top.get("w")), frame.get("h", top.get("h"))), "has another size")
        check_camera(path, header, frame, top)


def check_tensors(path):
    tensors = safetensors.numpy.load_file(path)
    with safetensors.safe_open(path, "numpy") as file:
        metadata = file.metadata()
    ours = json.loads(metadata["srnerf"])
    print(path, {name: tensor.shape for name, tensor in tensors.items()}, sorted(ours))
    check(path, metadata["format"] == "pt", "format is not pt")
    check(path, all(tensor.dtype == np.float32 for tensor in tensors.values()), "tensors are not all float")
    if "views" in ours:
        check(path, sorted(ours["views"]) == sorted(tensors), "views and tensors differ")


def check_lora(path, unet_folder):
    """Loads the weights into a UNet and compares every one."""
    try:
        from diffusers import UNet2DConditionModel
        from diffusers.loaders import StableDiffusionLoraLoaderMixin
    except ImportError:
        print(path, "not loaded: diffusers is not installed")
        return
    weights = safetensors.numpy.load_file(path)
    with safetensors.safe_open(path, "numpy") as file:
        adapter = json.loads(file.metadata()["lora_adapter_metadata"])
    rank, alpha = adapter["unet.r"], adapter["unet.lora_alpha"]
    unet = UNet2DConditionModel.from_config(json.loads((unet_folder / "config.json").read_text()))
    state, alphas, metadata = StableDiffusionLoraLoaderMixin.lora_state_dict(str(path.parent), return_lora_metadata=True)
    StableDiffusionLoraLoaderMixin.load_lora_into_unet(state, alphas, unet, metadata=metadata, adapter_name="srnerf")
    loaded = {name.replace(".srnerf.", "."): tensor.numpy(force=True) for name, tensor in unet.state_dict().items()}
    for name, tensor in weights.items():
        found = loaded.get(name.removeprefix("unet."))
        check(path, found is not None and (found == tensor).all(), f"{name} was not loaded")
    config = unet.peft_config["srnerf"]
    check(path, (config.r, config.lora_alpha) == (rank, alpha), f"loaded as rank {config.r}, alpha {config.lora_alpha}")
    print(path, f"loaded by diffusers: {len(weights)} tensors, rank {config.r}, alpha {config.lora_alpha}")


def main(folder, unet_folder=PRIOR_UNET):
    for path in sorted(Path(folder).rglob("*")):
        if path.suffix == ".exr":
            check_image(path)
        elif path.suffix == ".safetensors":
            check_tensors(path)
            if path.name == "pytorch_lora_weights.safetensors":
                check_lora(path, Path(unet_folder))
        elif path.suffix == ".png":
            with Image.open(path) as image:
                image.load()
                print(path, image.size, image.mode, image.info)
        elif path.suffix == ".gif":
            with Image.open(path) as film:
                print(path, film.size, film.n_frames, "frames of", film.info["duration"], "ms")
        elif path.suffix == ".json":
            print(path, sorted(json.loads(path.read_text())))
        elif path.suffix == ".jsonl":
            print(path, len([json.loads(line) for line in path.read_text().splitlines()]), "lines")
    for problem in problems:
        print("wrong:", problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
