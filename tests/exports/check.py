"""Reads exports of `srnerf-dag` in the current folder by other libraries, and compares them with the image sets that they are of.

python check.py TRAIN TEST      beside nerfstudio, brush, colmap and instant-ngp

pycolmap reads the reconstruction, plyfile the points, Pillow the pictures.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image
from plyfile import PlyData

LENS = ["w", "h", "fl_x", "fl_y", "cx", "cy"]


def frames(folder, file="transforms.json"):
    """Lens and pose by name, as a transforms.json says."""
    page = json.loads((Path(folder) / file).read_text())
    read = {}
    for frame in page["frames"]:
        lens = [frame.get(name, page.get(name)) for name in LENS]
        read[Path(frame["file_path"]).stem] = (lens, np.array(frame["transform_matrix"]))
    return read, page


def check_colmap(truth):
    model = pycolmap.Reconstruction("colmap/sparse/0")
    assert model.num_images() == len(truth), model.summary()
    for image in model.images.values():
        lens, pose = truth[Path(image.name).stem]
        camera = image.camera
        assert camera.model.name == "PINHOLE", camera
        assert np.allclose([camera.width, camera.height, *camera.params], lens, rtol=1e-12, atol=0), camera
        ours = np.eye(4)
        ours[:3] = image.cam_from_world().inverse().matrix()
        # From right, down, forwards to right, up, backwards.
        assert np.abs(ours @ np.diag([1, -1, -1, 1]) - pose).max() < 1e-12, image.name
        assert Image.open(f"colmap/images/{image.name}").size == (camera.width, camera.height)
        for point in ([0.2, -0.1, -3.0], [0.0, 0.3, -2.0]):
            world = pose @ [*point, 1.0]
            width, height, fl_x, fl_y, cx, cy = lens
            expected = [cx + fl_x * point[0] / -point[2], cy - fl_y * point[1] / -point[2]]
            assert np.allclose(image.project_point(world[:3]), expected, atol=1e-6), image.name
    print(f"pycolmap: {model.num_images()} images, {model.num_points3D()} points")
    return np.array([[*point.xyz, *point.color] for _, point in sorted(model.points3D.items())])


def check_points(file, points):
    vertices = PlyData.read(file)["vertex"]
    ours = np.stack([vertices[name] for name in ("x", "y", "z", "red", "green", "blue")], axis=1)
    assert np.allclose(ours, points, atol=1e-5), f"{file} and points3D.txt differ"
    print(f"plyfile: {file} has {len(ours)} points")


def check_frames(train, test):
    for layout, file in [("nerfstudio", "transforms.json"), ("brush", "transforms_train.json"), ("instant-ngp", "transforms.json")]:
        ours, page = frames(layout, file)
        truth = {**train, **test} if layout == "nerfstudio" else train
        assert sorted(ours) == sorted(truth), (layout, sorted(ours))
        for name, (lens, pose) in ours.items():
            assert lens == truth[name][0] and (pose == truth[name][1]).all(), (layout, name)
        for frame in page["frames"]:
            assert Image.open(Path(layout) / frame["file_path"]).mode == "RGB"
    names = json.loads(Path("nerfstudio/transforms.json").read_text())
    assert {Path(path).stem for path in names["test_filenames"]} == set(test)
    cube = json.loads(Path("instant-ngp/transforms.json").read_text())
    corners = np.array(cube["aabb"]) * cube["scale"] + cube["offset"]
    assert cube["aabb_scale"] == 1 and corners.min() > -1e-9 and corners.max() < 1 + 1e-9
    print("nerfstudio, brush and instant-ngp have the same cameras")


train, test = frames(sys.argv[1])[0], frames(sys.argv[2])[0]
points = check_colmap({**train, **test})
check_points("nerfstudio/points.ply", points)
check_points("brush/init.ply", points)
check_frames(train, test)
