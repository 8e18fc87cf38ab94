"""Reads paths from its input. For each prints a line of JSON for tests/suite: what independent readers (fieldcompare, trimesh) find in a
.vtp, .vti, .vtu, .pvd or .ply file.

Numbers keep all their digits: an f32 is printed as the f64 of the same value.
"""

import json
import os
import sys
from xml.etree import ElementTree

import numpy
import trimesh
from fieldcompare.io.vtk import VTIReader, VTPReader, VTUReader, read
from fieldcompare.mesh._mesh_fields import remove_cell_type_suffix


def fields(mesh_fields):
    """{name: {dtype, values}} of the point and of the cell fields; our files have one cell type each."""
    found = {"points": {}, "cells": {}}
    for field in mesh_fields.point_fields:
        found["points"][field.name] = {"dtype": str(field.values.dtype), "values": field.values.tolist()}
    for field, cell_type in mesh_fields.cell_fields_types:
        name = remove_cell_type_suffix(cell_type, field.name)
        found["cells"][name] = {"dtype": str(field.values.dtype), "values": field.values.tolist()}
    return found


def surface(path):
    """A surface of triangles as trimesh reads it, with what it says of its edges and its inside."""
    with open(path, "rb") as file:
        parts = trimesh.exchange.ply.load_ply(file)
    raw = parts["metadata"]["_ply_raw"]
    vertices = raw["vertex"]["data"]
    columns = lambda *names: numpy.stack([vertices[name].reshape(-1) for name in names], axis=-1).tolist()
    mesh = trimesh.Trimesh(parts["vertices"], parts["faces"], process=False) if len(vertices) else trimesh.Trimesh()
    # As users load it, and with vertices at one place merged whatever their normals.
    loaded = trimesh.load(path, force="mesh") if len(vertices) else mesh
    closed = bool(loaded.is_watertight)
    loaded.merge_vertices(merge_norm=True)
    corners = mesh.vertices[mesh.faces].reshape(-1, 3, 3)
    longest = numpy.linalg.norm(corners - numpy.roll(corners, 1, axis=1), axis=-1).max(axis=-1)
    heights = 2 * mesh.area_faces / longest if len(vertices) else numpy.zeros(0)
    return {
        "coincident": len(mesh.vertices) - len(loaded.vertices),
        "loads_watertight": closed and bool(loaded.is_watertight),
        "least_height": float(heights.min(initial=numpy.inf)) if len(heights) else 0.0,
        "coordinates": columns("x", "y", "z"),
        "normals": columns("nx", "ny", "nz"),
        "velocity": columns("vx", "vy", "vz"),
        "triangles": mesh.faces.tolist(),
        "watertight": bool(mesh.is_watertight),
        "winding": bool(mesh.is_winding_consistent),
        "volume": float(mesh.volume),
        "area": float(mesh.area),
    }


def describe(path):
    """Everything in one file."""
    extension = os.path.splitext(path)[1]
    if extension == ".ply":
        return surface(path)
    if extension == ".pvd":
        times = [float(entry.attrib["timestep"]) for entry in ElementTree.parse(path).iter("DataSet")]
        frames = [fields(frame) for frame in read(path)]
        return {"times": times, "frames": frames}
    reader = {".vtp": VTPReader, ".vti": VTIReader, ".vtu": VTUReader}[extension](path)
    mesh_fields = reader.read()
    mesh = mesh_fields.domain
    found = fields(mesh_fields)
    if extension == ".vti":
        found["origin"], found["spacing"] = reader.origin, reader.spacing
        found["extents"] = [int(n) for n in mesh.extents]
    else:
        found["dtype"] = str(mesh.points.dtype)
        found["coordinates"] = mesh.points.tolist()
        found["connectivity"] = {kind.name: mesh.connectivity(kind).tolist() for kind in mesh.cell_types}
    return found


for line in sys.stdin:
    print(json.dumps(describe(line.rstrip("\n"))), flush=True)
