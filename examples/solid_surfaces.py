"""Writes the surface of each solid of a run as frames/NAME_SOLID_%06d.ply, with the velocities vx, vy, vz. Needs numpy and meshio.

usage: python3 examples/solid_surfaces.py out/splash
"""
import json
import sys
from pathlib import Path

import meshio
import numpy as np

run = Path(sys.argv[1])
solids = [solid["name"] for solid in json.loads((run / "manifest.json").read_text())["solids"]]
frames = sorted((run / "frames").glob("*_[0-9]*.vtu"))
for frame in frames:
    mesh = meshio.read(frame)
    # meshio returns unsigned connectivity as floats.
    tets, body, velocity = mesh.cells_dict["tetra"].astype(int), mesh.cell_data["solid"][0], mesh.point_data["velocity"]
    for number, solid in enumerate(solids):
        # The four sides of a tetrahedron, with normals out of it; those that belong to one tetrahedron alone are the surface.
        sides = tets[body == number][:, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]].reshape(-1, 3)
        _, first, count = np.unique(np.sort(sides), axis=0, return_index=True, return_counts=True)
        nodes, triangles = np.unique(sides[first[count == 1]], return_inverse=True)
        columns = dict(zip(("vx", "vy", "vz"), velocity[nodes].T.astype(np.float32)))
        surface = meshio.Mesh(mesh.points[nodes].astype(np.float32), {"triangle": triangles.reshape(-1, 3).astype(np.int32)}, point_data=columns)
        name, _, index = frame.stem.rpartition("_")
        surface.write(frame.with_name(f"{name}_{solid}_{index}.ply"))
print(f"{len(frames)} frames of {', '.join(solids)}")
