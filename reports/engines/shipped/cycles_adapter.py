"""Blender's Cycles for the neutral scene file: python cycles_adapter.py SCENE OUTPUT --spp 64 --seed 1 --depth 1000.

Blender as it comes is not what a reference is compared with: a pixel filter wider than a pixel, 12 bounces, clamped
indirect light, samples that stop early, light sampling that leaves dim lamps out. All that is set here; `--as-it-comes`
leaves it, `--set name=value` sets a property of `scene.cycles` after that. It runs in Python with the module bpy, or
in Blender: blender -b --python cycles_adapter.py -- SCENE OUTPUT ...
"""

# pyright: reportMissingImports=false
import argparse
import json
import math
import sys

import bpy
from mathutils import Matrix, Vector

MOST_BOUNCES = 1024


def main() -> None:
    """Render one image."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("output")
    for name, value in (("spp", 64), ("seed", 0), ("depth", MOST_BOUNCES), ("threads", 1)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--as-it-comes", action="store_true")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    given = parser.parse_args(sys.argv[sys.argv.index("--") + 1 if "--" in sys.argv else 1 :])
    with open(given.scene) as file:
        described = json.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    for number, thing in enumerate(described["objects"]):
        place(scene, f"object{number}", mesh(f"object{number}", thing))
    for number, light in enumerate(described["lights"]):
        place(scene, f"light{number}", point(f"light{number}", light)).location = light["position"]
    sky(scene, described["sky"])
    camera(scene, described["camera"])
    settings(scene, described["film"]["resolution"], given)
    bpy.ops.render.render(write_still=True)


def place(scene, name, data):
    """An object in the scene."""
    placed = bpy.data.objects.new(name, data)
    scene.collection.objects.link(placed)
    return placed


def mesh(name, thing):
    """A mesh with its material; Blender drops faces that it finds invalid, which would be another scene."""
    made = bpy.data.meshes.new(name)
    made.from_pydata(thing["vertices"], [], thing["faces"])
    made.validate()
    made.update()
    if len(made.polygons) != len(thing["faces"]):
        taken = f"Blender takes {len(made.polygons)} of {len(thing['faces'])} faces"
        raise SystemExit(f"objects: {thing['name']!r}: {taken}")
    made.materials.append(material(name, thing))
    return made


def material(name, thing):
    """Diffuse on both sides; what emits does so on its front alone."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, link = made.node_tree.nodes, made.node_tree.links.new
    nodes.clear()
    surface = nodes.new("ShaderNodeOutputMaterial").inputs["Surface"]
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = [*thing["material"]["color"], 1.0]
    diffuse.inputs["Roughness"].default_value = 0.0
    peak = max(thing["emission"])
    if peak == 0.0:
        link(diffuse.outputs[0], surface)
        return made
    emission, both = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeAddShader")
    emission.inputs["Color"].default_value = [*(value / peak for value in thing["emission"]), 1.0]
    emission.inputs["Strength"].default_value = peak
    link(emission.outputs[0], both.inputs[0])
    link(diffuse.outputs[0], both.inputs[1])
    sides, geometry = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeNewGeometry")
    link(geometry.outputs["Backfacing"], sides.inputs[0])
    link(both.outputs[0], sides.inputs[1])
    link(diffuse.outputs[0], sides.inputs[2])
    link(sides.outputs[0], surface)
    return made


def point(name, light):
    """Blender's power of a point light is 4 pi times the radiant intensity."""
    made = bpy.data.lights.new(name, "POINT")
    peak = max(light["intensity"])
    made.color = [value / peak for value in light["intensity"]]
    made.energy = 4.0 * math.pi * peak
    made.shadow_soft_size = 0.0
    return made


def sky(scene, described):
    """A constant radiance."""
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    background = scene.world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = [*(described["radiance"] if described else (0.0, 0.0, 0.0)), 1.0]
    background.inputs["Strength"].default_value = 1.0


def camera(scene, described):
    """A pinhole, by its field of view across the width."""
    made = bpy.data.cameras.new("camera")
    made.sensor_fit = "HORIZONTAL"
    made.angle_x = math.radians(described["horizontal_fov"])
    made.clip_start, made.clip_end = 1e-4, 1e6
    placed = place(scene, "camera", made)
    right, up, forward = (Vector(described[name]) for name in ("right", "up", "forward"))
    turn = Matrix((right, up, -forward)).transposed().to_4x4()
    placed.matrix_world = Matrix.Translation(described["position"]) @ turn
    scene.camera = placed


def settings(scene, resolution, given):
    """What is rendered, how, and where to."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = resolution
    scene.render.resolution_percentage = 100
    scene.render.threads_mode, scene.render.threads = "FIXED", given.threads
    image = scene.render.image_settings
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGB", "32", "ZIP"
    scene.render.filepath = given.output
    cycles = scene.cycles
    cycles.samples, cycles.seed = given.spp, given.seed
    if not given.as_it_comes:
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.pixel_filter_type = "BOX"
        bounces = min(given.depth - 1, MOST_BOUNCES)  # Blender does not count the first
        cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
        cycles.light_sampling_threshold = 0.0
        cycles.caustics_reflective = True
        cycles.blur_glossy = 0.0
    for word in given.set:
        name, _, value = word.partition("=")
        setattr(cycles, name, type(getattr(cycles, name))(value))


main()
