"""Reads the splats that `srnerf-dag export splat` wrote in three formats, and compares them.

python splats.py      beside splats.ply, splats.glb and splats.usda

plyfile, pygltflib and usd-core read them.
"""

import numpy as np
from plyfile import PlyData
from pxr import Usd, UsdVol
from pygltflib import GLTF2


def splats_of_ply():
    vertices = PlyData.read("splats.ply")["vertex"]
    columns = lambda names: np.stack([vertices[name] for name in names], axis=1)
    rest = columns([f"f_rest_{i}" for i in range(9)]).reshape(-1, 3, 3)
    harmonics = np.concatenate([columns([f"f_dc_{i}" for i in range(3)])[:, None], rest.transpose(0, 2, 1)], axis=1)
    turn = columns([f"rot_{i}" for i in range(4)])
    assert np.allclose(np.linalg.norm(turn, axis=1), 1, atol=1e-5)
    return {
        "positions": columns("xyz"),
        "turns": turn,
        "scales": np.exp(columns([f"scale_{i}" for i in range(3)])),
        "opacities": 1 / (1 + np.exp(-vertices["opacity"])),
        "harmonics": harmonics,
    }


def splats_of_gltf():
    gltf = GLTF2().load("splats.glb")
    primitive = gltf.meshes[0].primitives[0]
    told = primitive.extensions["KHR_gaussian_splatting"]
    assert primitive.mode == 0 and told["kernel"] == "ellipse" and told["colorSpace"] == "srgb_rec709_display"
    # The names of an extension's attributes are no fields of pygltflib's class.
    attributes = vars(primitive.attributes)
    blob = gltf.binary_blob()
    widths = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

    def column(name):
        accessor = gltf.accessors[attributes[name]]
        view = gltf.bufferViews[accessor.bufferView]
        values = np.frombuffer(blob, np.float32, accessor.count * widths[accessor.type], view.byteOffset)
        return values.reshape(accessor.count, -1)

    own = lambda name: column(f"KHR_gaussian_splatting:{name}")
    harmonics = [own("SH_DEGREE_0_COEF_0"), *(own(f"SH_DEGREE_1_COEF_{i}") for i in range(3))]
    return {
        "positions": column("POSITION"),
        "turns": np.roll(own("ROTATION"), 1, axis=1),
        "scales": own("SCALE"),
        "opacities": own("OPACITY")[:, 0],
        "harmonics": np.stack(harmonics, axis=1),
    }


def splats_of_usd():
    stage = Usd.Stage.Open("splats.usda")
    prim = stage.GetDefaultPrim()
    assert prim.IsA(UsdVol.ParticleField3DGaussianSplat), prim.GetTypeName()
    read = lambda name: np.array(prim.GetAttribute(name).Get())
    turns = prim.GetAttribute("orientations").Get()
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
    assert Usd.ColorSpaceAPI(prim).GetColorSpaceNameAttr().Get() == "srgb_rec709_display"
    return {
        "positions": read("positions"),
        "turns": np.array([[turn.GetReal(), *turn.GetImaginary()] for turn in turns]),
        "scales": read("scales"),
        "opacities": read("opacities"),
        "harmonics": read("radiance:sphericalHarmonicsCoefficients").reshape(-1, (degree + 1) ** 2, 3),
    }


def check_splats():
    ply, gltf, usd = splats_of_ply(), splats_of_gltf(), splats_of_usd()
    count = len(ply["positions"])
    assert 0 < count <= 3000, count
    for other in (gltf, usd):
        for name, values in ply.items():
            assert values.shape == other[name].shape, (name, values.shape, other[name].shape)
            assert np.allclose(values, other[name], rtol=1e-4, atol=1e-6), name
    print(f"plyfile, pygltflib and usd-core read the same {count} splats")


check_splats()
