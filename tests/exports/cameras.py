"""Reads the cameras that `srnerf-dag export cameras` wrote, by usd-core and pygltflib, and compares them with those of image sets.

python cameras.py PATH VIEWS      beside path.usda, path.gltf, path.glb, views.usda ...
"""

import base64
import json
import sys
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom
from pygltflib import GLTF2


def cameras(folder):
    page = json.loads((Path(folder) / "transforms.json").read_text())
    read = []
    for frame in page["frames"]:
        lens = {name: frame.get(name, page.get(name)) for name in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
        read.append((Path(frame["file_path"]).stem, lens, np.array(frame["transform_matrix"])))
    return read


def check_usd(file, truth, moves):
    stage = Usd.Stage.Open(file)
    prims = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
    assert len(prims) == (1 if moves else len(truth))
    if moves:
        assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (1, len(truth))
        assert stage.GetFramesPerSecond() == 24
    for i, (name, lens, pose) in enumerate(truth):
        prim = prims[0 if moves else i]
        time = Usd.TimeCode(i + 1) if moves else Usd.TimeCode.Default()
        assert moves or prim.GetDisplayName() == name
        camera = UsdGeom.Camera(prim).GetCamera(time)
        world = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)).T
        assert (world == pose).all(), (file, name)
        # Where USD's frustum sees a point of the camera's space, beside the pinhole.
        frustum = camera.frustum
        matrix = np.array(frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix())
        for point in ([0.2, -0.1, -3.0], [0.0, 0.3, -2.0]):
            clip = np.append((pose @ [*point, 1.0])[:3], 1.0) @ matrix
            x, y = clip[0] / clip[3], clip[1] / clip[3]
            seen = [(x + 1) / 2 * lens["w"], (1 - y) / 2 * lens["h"]]
            expected = [lens["cx"] + lens["fl_x"] * point[0] / -point[2], lens["cy"] - lens["fl_y"] * point[1] / -point[2]]
            assert np.allclose(seen, expected, atol=1e-3), (file, name, seen, expected)
    print(f"usd-core: {file} has {len(prims)} cameras, {len(truth)} poses to the last bit")


def turned(quaternion):
    return np.array(Gf.Matrix3d(Gf.Quatd(float(quaternion[3]), *map(float, quaternion[:3])))).T


def check_gltf(file, truth, moves):
    gltf = GLTF2().load(file)
    root = gltf.nodes[gltf.scenes[0].nodes[0]]
    nodes = [gltf.nodes[i] for i in root.children]
    blob = gltf.binary_blob() if file.endswith(".glb") else None
    if moves and blob is None:
        blob = base64.b64decode(gltf.buffers[0].uri.split(",")[1])

    def column(accessor, width):
        accessor = gltf.accessors[accessor]
        view = gltf.bufferViews[accessor.bufferView]
        return np.frombuffer(blob, np.float32, accessor.count * width, view.byteOffset).reshape(-1, width)

    if moves:
        animation = gltf.animations[0]
        by_path = {channel.target.path: animation.samplers[channel.sampler] for channel in animation.channels}
        times = column(by_path["translation"].input, 1)[:, 0]
        assert np.allclose(times, np.arange(len(truth)) / 24, atol=1e-6)
        places = column(by_path["translation"].output, 3)
        turns = column(by_path["rotation"].output, 4)
    for i, (name, lens, pose) in enumerate(truth):
        place, turn = (places[i], turns[i]) if moves else (nodes[i].translation, nodes[i].rotation)
        tolerance = 1e-6 if moves else 1e-13
        assert np.allclose(place, pose[:3, 3], atol=tolerance * 10), (file, name)
        assert np.allclose(turned(turn), pose[:3, :3], atol=tolerance), (file, name)
        seen = gltf.cameras[nodes[0 if moves else i].camera].perspective
        height = lens["h"] / 2 / np.tan(seen.yfov / 2)
        assert np.isclose(height, lens["fl_y"]) and np.isclose(height * lens["w"] / lens["h"] / seen.aspectRatio, lens["fl_x"])
    print(f"pygltflib: {file} has {len(nodes)} cameras, {len(truth)} poses")


for name, folder, moves in [("path", sys.argv[1], True), ("views", sys.argv[2], False)]:
    truth = cameras(folder)
    check_usd(f"{name}.usda", truth, moves)
    for ending in ("gltf", "glb"):
        check_gltf(f"{name}.{ending}", truth, moves)
