"""Imports the .ply files of a run into Blender 4.2 or newer and saves a .blend file. Each frame is an object, shown in that frame only.

usage: python3 examples/blender.py RUN FILE.blend [FRAME]      with the module bpy; FRAME is rendered to FILE.png
       blender --background --python examples/blender.py -- RUN FILE.blend [FRAME]
"""
import json
import math
import re
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

arguments = sys.argv[sys.argv.index("--") + 1:] if "--" in sys.argv else sys.argv[1:]
run, target = (Path(argument).resolve() for argument in arguments[:2])
manifest = json.loads((run / "manifest.json").read_text())
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene


def z_up(vector):
    """From cutwater's axes (y is up) to Blender's (z is up)."""
    x, y, z = vector
    return Vector((x, -z, y))


def material(body):
    """Glass that refracts as water does for the liquid, plain colours for solids."""
    made = bpy.data.materials.new(body)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"].inputs
    if body == manifest["scene"]["name"]:
        shader["Base Color"].default_value = (0.6, 0.85, 0.95, 1)
        shader["Transmission Weight"].default_value, shader["Roughness"].default_value, shader["IOR"].default_value = 1, 0.02, 1.33
    else:
        shader["Base Color"].default_value = (0.8, 0.3, 0.1, 1) if len(materials) % 2 else (0.2, 0.5, 0.15, 1)
    return made


materials = {}
for file in sorted((run / "frames").glob("*.ply")):
    numbered = re.fullmatch(r"(.*)_(\d{6})", file.stem)
    # Obstacles that move have a file per frame too.
    if not numbered and list(file.parent.glob(f"{file.stem}_*.ply")):
        continue
    body, frame = numbered.groups() if numbered else (file.stem, None)
    bpy.ops.wm.ply_import(filepath=str(file), forward_axis="NEGATIVE_Z", up_axis="Y")
    shape, mesh = bpy.context.object, bpy.context.object.data
    # m/s, for the motion blur of Cycles. The importer rotates positions, not attributes.
    if "vx" in mesh.attributes:
        velocity = np.empty((3, len(mesh.vertices)), np.float32)
        for name, row in zip(("vx", "vy", "vz"), velocity):
            mesh.attributes[name].data.foreach_get("value", row)
        turned = np.stack((velocity[0], -velocity[2], velocity[1]), axis=1)
        mesh.attributes.new("velocity", "FLOAT_VECTOR", "POINT").data.foreach_set("vector", turned.ravel())
    mesh.shade_smooth()
    if body not in materials:
        materials[body] = material(body)
    mesh.materials.append(materials[body])
    for at, hidden in () if frame is None else ((int(frame) - 1, True), (int(frame), False), (int(frame) + 1, True)):
        shape.hide_render = shape.hide_viewport = hidden
        shape.keyframe_insert("hide_render", frame=at)
        shape.keyframe_insert("hide_viewport", frame=at)

eye, target_point = z_up(manifest["camera"]["eye"]), z_up(manifest["camera"]["target"])
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.location, camera.rotation_euler = eye, (target_point - eye).to_track_quat("-Z", "Y").to_euler()
camera.data.sensor_fit, camera.data.angle = "VERTICAL", math.radians(manifest["camera"]["fov"])
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy, sun.rotation_euler = 3, (0.7, 0.3, 0)
for thing in (camera, sun):
    scene.collection.objects.link(thing)
scene.camera = camera
scene.world = bpy.data.worlds.new("sky")
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.6, 0.75, 0.9, 1)
scene.frame_start, scene.frame_end = 0, manifest["options"]["frames"]
scene.render.fps, scene.render.fps_base = round(manifest["frames_per_second"]), round(manifest["frames_per_second"]) / manifest["frames_per_second"]
scene.render.resolution_x, scene.render.resolution_y = manifest["camera"]["size"]
scene.render.engine, scene.cycles.samples = "CYCLES", 64
scene.render.use_motion_blur = True
scene.render.filepath = str(target.with_suffix(".png"))
bpy.ops.wm.save_as_mainfile(filepath=str(target))
print(f"{target.name}: {len(bpy.data.objects)} objects, {', '.join(materials)}")
if len(arguments) > 2:
    scene.frame_set(int(arguments[2]))
    bpy.ops.render.render(write_still=True)
