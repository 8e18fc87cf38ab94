"""Writes mesh files with trimesh and meshio into a folder; prints as JSON what the same libraries read from them and from own.vtu."""
import json
import sys
from pathlib import Path

import meshio
import numpy
import trimesh

out = Path(sys.argv[1])

# A ring, a body with a cavity, two bodies.
ring = trimesh.creation.annulus(r_min=0.2, r_max=0.5, height=0.3)
cavity = trimesh.creation.box((0.5, 0.5, 0.5))
cavity.invert()
hollow = trimesh.util.concatenate(trimesh.creation.box((1, 1, 1)), cavity)
two = trimesh.util.concatenate(
    trimesh.creation.icosphere(subdivisions=2, radius=0.3),
    trimesh.creation.cylinder(radius=0.2, height=0.5).apply_translation((1, 0.2, 0.1)),
)
names = []


def write(name, export):
    export(str(out / name))
    names.append(name)


for body, mesh in (("ring", ring), ("hollow", hollow), ("two", two)):
    write(f"{body}.obj", mesh.export)
    write(f"{body}.stl", mesh.export)
    write(f"{body}_text.stl", lambda file: mesh.export(file, file_type="stl_ascii"))
    write(f"{body}.ply", mesh.export)
    write(f"{body}_text.ply", lambda file: mesh.export(file, encoding="ascii"))
    cells = [("triangle", mesh.faces)]
    surface = meshio.Mesh(mesh.vertices, cells)
    write(f"{body}_meshio.obj", surface.write)
    for binary in (False, True):
        kind = "binary" if binary else "text"
        for end in ("stl", "ply"):
            write(f"{body}_meshio_{kind}.{end}", lambda file: surface.write(file, binary=binary))

# A box of quadrilaterals.
corners = numpy.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)], dtype=float)
sides = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
quads = meshio.Mesh(corners, [("quad", sides)])
write("quads.obj", quads.write)
write("quads.ply", quads.write)

# Tetrahedra around the middle of an icosahedron, with its triangles.
ball = trimesh.creation.icosahedron()
points = numpy.vstack([ball.vertices, [[0, 0, 0]]])
tetrahedra = [[12, *face] for face in ball.faces]
alone = meshio.Mesh(points, [("tetra", tetrahedra)])
solid = meshio.Mesh(points, [("triangle", ball.faces), ("tetra", tetrahedra)])
for binary in (False, True):
    kind = "binary" if binary else "text"
    write(f"ball_{kind}.msh", lambda file: alone.write(file, file_format="gmsh", binary=binary))
    write(f"ball_{kind}.vtu", lambda file: solid.write(file, binary=binary))
write("ball_plain.vtu", lambda file: solid.write(file, compression=None))


def volume_of_tetrahedra(mesh):
    total = 0.0
    for cell in mesh.get_cells_type("tetra").astype(int):
        a, b, c, d = mesh.points[cell]
        total += abs(numpy.dot(b - a, numpy.cross(c - a, d - a))) / 6
    return total


found = {}
for name in [*names, "own.vtu"]:
    file = str(out / name)
    if name.endswith(("msh", "vtu")):
        mesh = meshio.read(file)
        points, n, volume = mesh.points, len(mesh.get_cells_type("tetra")), volume_of_tetrahedra(mesh)
    else:
        mesh = trimesh.load(file, force="mesh")
        points, n, volume = mesh.vertices, len(mesh.faces), mesh.volume
    bounds = [points.min(axis=0).tolist(), points.max(axis=0).tolist()]
    found[name] = {"volume": float(volume), "cells": n, "bounds": bounds}
print(json.dumps(found))
