"""LuxCore for the neutral scene file: python luxcore_adapter.py SCENE OUTPUT --spp 64 --seed 1 --depth 1000.

LuxCore as it comes filters pixels by a Blackman-Harris window, scatters light 6 times, samples adaptively, and ends
paths by a Russian roulette that adds light (version 2.11.2: 13 % in a closed box of albedo 0.95). That is set here, the
roulette begins where next to no light is left; `--as-it-comes` leaves all of it, `--set name=value` sets a property of
LuxCore's after that. Its images stand one row of pixels lower than those of a pinhole whose window is symmetric: the
window is moved by one row to undo that.
"""

# pyright: reportMissingImports=false
import argparse
import json
import math
import os
import sys
import time

import numpy as np  # noqa: F401  before pyluxcore, which else finds no symbols of it
import pyluxcore

ROWS_LOWER = 1
"""How many rows its images stand too low."""
ROULETTE = 200
"""Vertices before the roulette: at an albedo of 0.95 they leave 4e-5 of the light."""


def main() -> None:
    """Render one image."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene")
    parser.add_argument("output")
    for name, value in (("spp", 64), ("seed", 0), ("depth", 1000), ("threads", 1), ("rows-lower", ROWS_LOWER)):
        parser.add_argument(f"--{name}", type=int, default=value)
    parser.add_argument("--roulette", type=int, default=ROULETTE)
    parser.add_argument("--as-it-comes", action="store_true")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    given = parser.parse_args()
    with open(given.scene) as file:
        described = json.load(file)
    pyluxcore.Init(lambda message: None)
    scene = pyluxcore.Scene()
    told = camera(described, given.rows_lower)
    for number, thing in enumerate(described["objects"]):
        told |= shape(scene, f"object{number}", thing)
    for number, light in enumerate(described["lights"]):
        told |= point(f"scene.lights.light{number}", light)
    if described["sky"]:
        told |= {"scene.lights.sky.type": "constantinfinite", "scene.lights.sky.color": described["sky"]["radiance"]}
        told |= {"scene.lights.sky.gain": [1.0] * 3}
    scene.Parse(properties(told))
    chosen = settings(described["film"]["resolution"], given) | dict(word.split("=", 1) for word in given.set)
    config = pyluxcore.RenderConfig(properties(chosen), scene)
    session = pyluxcore.RenderSession(config)
    session.Start()
    while not session.HasDone():
        time.sleep(0.02)
        session.UpdateStats()
    session.Stop()
    session.GetFilm().SaveOutputs()


def properties(values):
    """LuxCore's properties of a dictionary."""
    made = pyluxcore.Properties()
    for name, value in values.items():
        listed = value if isinstance(value, list) else [value]
        made.Set(pyluxcore.Property(name, [float(x) if isinstance(x, float) else x for x in listed]))
    return made


def camera(described, rows_lower):
    """A pinhole; the window is in units of half the width."""
    seen, (width, height) = described["camera"], described["film"]["resolution"]
    down = -2.0 * rows_lower / width
    return {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": seen["position"],
        "scene.camera.lookat.target": [a + b for a, b in zip(seen["position"], seen["forward"], strict=True)],
        "scene.camera.up": seen["up"],
        "scene.camera.fieldofview": seen["horizontal_fov"],
        "scene.camera.screenwindow": [-1.0, 1.0, -height / width + down, height / width + down],
        "scene.camera.lensradius": 0.0,
        "scene.camera.autofocus.enable": False,
        "scene.camera.cliphither": 1e-4,
    }


def shape(scene, name, thing):
    """A mesh, diffuse on both sides; lamps shine from their front."""
    vertices = [tuple(map(float, vertex)) for vertex in thing["vertices"]]
    scene.DefineMesh(name, vertices, [tuple(face) for face in thing["faces"]], None, None, None, None)
    material = f"scene.materials.{name}"
    told = {f"{material}.type": "matte", f"{material}.kd": thing["material"]["color"]}
    if any(thing["emission"]):
        told |= {f"{material}.emission": thing["emission"], f"{material}.emission.gain": [1.0] * 3}
        told |= {f"{material}.emission.power": 0.0, f"{material}.emission.efficency": 0.0}
    return told | {f"scene.objects.{name}.shape": name, f"scene.objects.{name}.material": name}


def point(name, light):
    """LuxCore's colour of a point light is 4 pi times the radiant intensity."""
    return {
        f"{name}.type": "point",
        f"{name}.position": light["position"],
        f"{name}.color": [4.0 * math.pi * value for value in light["intensity"]],
        f"{name}.gain": [1.0] * 3,
        f"{name}.power": 0.0,
        f"{name}.efficency": 0.0,
    }


def settings(resolution, given):
    """What is rendered, how, and where to."""
    told = {
        "renderengine.type": "PATHCPU",
        "renderengine.seed": given.seed + 1,  # 0 is none
        "film.width": resolution[0],
        "film.height": resolution[1],
        "film.outputs.0.type": "RGB",
        "film.outputs.0.filename": given.output,
        "batch.haltspp": given.spp,
        "native.threads.count": given.threads,
    }
    if given.as_it_comes:
        return told
    return told | {
        "sampler.type": "RANDOM",
        "sampler.random.adaptive.strength": 0.0,
        "film.filter.type": "BOX",
        "film.filter.width": 0.5,
        "film.filter.xwidth": 0.5,
        "film.filter.ywidth": 0.5,
        "path.pathdepth.total": given.depth,
        "path.pathdepth.diffuse": given.depth,
        "path.pathdepth.glossy": given.depth,
        "path.pathdepth.specular": given.depth,
        "path.russianroulette.depth": given.roulette,
        "path.clamping.variance.maxvalue": 0.0,
        "path.hybridbackforward.enable": False,
    }


main()
sys.stdout.flush()
os._exit(0)  # pyluxcore aborts when Python ends
