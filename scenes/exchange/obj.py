"""Wavefront OBJ with its MTL: geometry, names and colours; a comment says the rest.

`Kd` is the Lambertian reflectance, `Ke` the radiance of a lamp, `Ks` and `Ns` the Phong lobe that stands for gloss.
Coordinates have all digits of their float32.
"""

import re
from pathlib import Path
from typing import Any

from termwise.scenes.exchange import spheres
from termwise.scenes.exchange.neutral import describe, refuse_images
from termwise.scenes.model import Scene
from termwise.scenes.store import write_atomically

SUFFIX = ".obj"


def write(scene: Scene, path: Path) -> list[str]:
    """Write a scene as OBJ, and NAME.mtl beside it; return what they do not say, as their comments do."""
    refuse_images(scene, "OBJ")
    given = describe(scene)
    described, of_triangles = spheres.meshed(given)
    missing = given["left_out"] + of_triangles + left_out(given)
    comment = [f"# {line}" for line in (f"{described['name']}: not in this file:", *missing)]
    names = material_names([thing["name"] for thing in described["objects"]])
    library = path.with_suffix(".mtl")
    lines, vertices, normals = [*comment, f"mtllib {library.name}"], 1, 1
    for thing, name in zip(described["objects"], names, strict=True):
        lines += ["", f"o {_named(thing['name'])}"]
        lines += [f"v {_row(vertex)}" for vertex in thing["vertices"]]
        if thing["normals"] is not None:
            lines += [f"vn {_row(normal)}" for normal in thing["normals"]]
        lines += [f"usemtl {name}", f"s {'off' if thing['normals'] is None else '1'}"]
        for face in thing["faces"]:
            corners = [
                f"{vertices + i}" if thing["normals"] is None else f"{vertices + i}//{normals + i}" for i in face
            ]
            lines.append(f"f {' '.join(corners)}")
        vertices += len(thing["vertices"])
        normals += len(thing["normals"] or ())
    materials = [*comment]
    for thing, name in zip(described["objects"], names, strict=True):
        materials += ["", f"newmtl {name}", *_material(thing)]
    write_atomically(library, lambda temporary: temporary.write_text("\n".join(materials) + "\n", "utf-8"))
    write_atomically(path, lambda temporary: temporary.write_text("\n".join(lines) + "\n", "utf-8"))
    return missing


def left_out(described: dict[str, Any]) -> list[str]:
    """What OBJ cannot say of a scene described."""
    camera = described["camera"]
    width, height = described["film"]["resolution"]
    found = [
        f"camera: at {_row(camera['position'])}, forward {_row(camera['forward'])}, up {_row(camera['up'])}, "
        f"{camera['horizontal_fov']!r} degrees across, {width} x {height} pixels: OBJ has none"
    ]
    found += [
        f"objects: {thing['name']!r}: is called {_named(thing['name'])!r}"
        for thing in described["objects"]
        if _named(thing["name"]) != thing["name"]
    ]
    found += [
        f"lights[{number}]: {_said(light)}: OBJ has none"
        for number, light in enumerate(described["lights"])
        if light["type"] != "sphere"
    ]
    if described["sky"] is not None:
        found.append(f"sky: {described['sky']['type']}: OBJ has none")
    found += [
        f"objects: {thing['name']!r}: gloss = {thing['material']['gloss']!r}: MTL has Phong's lobe, not Beckmann's"
        for thing in described["objects"]
        if thing["material"]["gloss"] > 0.0
    ]
    found += [
        f"objects: {thing['name']!r}: transparency = {thing['material']['transparency']!r}: MTL's glass (illum 7) is "
        "smooth, and readers differ in what they make of it"
        for thing in described["objects"]
        if "transparency" in thing["material"]
    ]
    found += [
        f"objects: {thing['name']!r}: translucency = {thing['material']['translucency']!r}: MTL has none: all of Kd "
        "stays on its side"
        for thing in described["objects"]
        if "translucency" in thing["material"]
    ]
    found += [
        f"objects: {thing['name']!r}: emission: MTL does not say which side shines: that of the normals is meant"
        for thing in described["objects"]
        if any(thing["emission"])
    ]
    return found


def material_names(objects: list[str]) -> list[str]:
    """A name for the material of each object: without white space, which many readers take for an end, and distinct."""
    names: list[str] = []
    for name in objects:
        plain = _named(name).replace(" ", "_")
        while plain in names:
            plain += "_"
        names.append(plain)
    return names


def _said(light: dict[str, Any]) -> str:
    """A light in words: its type, then its numbers by name."""
    numbers = (
        f"{name} {_row(value) if isinstance(value, list) else repr(value)}"
        for name, value in light.items()
        if name != "type"
    )
    return f"{light['type']}, {', '.join(numbers)}"


def _named(name: str) -> str:
    r"""A name on its line: a comment would begin at #, and \ would go on in the next."""
    return " ".join(re.sub(r"[#\\]", "_", name).split())


def _material(thing: dict[str, Any]) -> list[str]:
    material, gloss = thing["material"], thing["material"]["gloss"]
    transparency = material.get("transparency", 0.0)
    lines = [f"Kd {_row([(1.0 - gloss) * (1.0 - transparency) * color for color in material['color']])}"]
    f0 = [((material["ior"] - 1.0) / (material["ior"] + 1.0)) ** 2] * 3 if "ior" in material else material["f0"]
    if "ior" in material:
        lines.append(f"Ni {material['ior']!r}")
    if transparency > 0.0:
        lines.append(f"Tf {_row([transparency * each for each in material['tint']])}")
    if gloss > 0.0:
        lines.append(f"Ks {_row([gloss * each for each in f0])}")
        lines.append(f"Ns {max(2.0 / material['roughness'] ** 2 - 2.0, 0.0)!r}")  # Beckmann's D is about Phong's there
    if any(thing["emission"]):
        lines.append(f"Ke {_row(thing['emission'])}")
    return [*lines, f"illum {7 if transparency > 0.0 else 2 if gloss > 0.0 else 1}"]


def _row(values: list[float]) -> str:
    return " ".join(repr(value) for value in values)
