"""Opens a PLY from `srnerf-dag export ply` with readers that share no code with srnerf-dag, and checks what they say.

    pip install plyfile trimesh numpy
    python check_ply.py FILE

Prints what it finds; exits with 1 if the file is not a coloured surface whose normals lead outwards.
"""

import sys

import numpy as np
import trimesh
from plyfile import PlyData

path = sys.argv[1]
ply = PlyData.read(path)
vertices = ply["vertex"]
names = [property.name for property in vertices.properties]
assert names == ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"], names
points = np.stack([vertices[axis] for axis in "xyz"], axis=1)
normals = np.stack([vertices["n" + axis] for axis in "xyz"], axis=1)
assert len(points) > 0 and np.isfinite(points).all()
assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-4)
print(f"plyfile: {len(points)} points from {points.min(axis=0)} to {points.max(axis=0)}")
print(f"mean colour {[float(np.mean(vertices[name])) for name in ('red', 'green', 'blue')]}")

if "face" in ply:
    mesh = trimesh.load(path, process=False)
    assert len(mesh.vertices) == len(points), "trimesh sees other vertices"
    agreement = np.einsum("ij,ij->i", mesh.face_normals, normals[mesh.faces[:, 0]])
    print(f"trimesh: {len(mesh.faces)} triangles, watertight: {mesh.is_watertight}, volume {mesh.volume:.4f}")
    assert (agreement > 0).mean() > 0.9, "faces and normals do not agree"
    assert mesh.volume > 0, "the faces look inwards"
    assert mesh.visual.kind == "vertex", "trimesh sees no colours"
