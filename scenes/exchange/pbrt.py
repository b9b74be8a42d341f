"""pbrt-v4's text: directives, and parameters as `"type name" [ values ]`.

pbrt's camera looks along +z of a left-handed frame, hence the `Scale -1 1 1`; its `fov` is across the shorter side. Its
default sensor reads `rgb L` of a light as the same radiance. Nothing here was rendered by pbrt: its syntax is tested,
by the grammar of its parser.
"""

import math
from pathlib import Path
from typing import Any

from termwise.scenes.exchange import panorama
from termwise.scenes.exchange.neutral import describe, refuse_images
from termwise.scenes.images import openexr
from termwise.scenes.model import Scene
from termwise.scenes.store import write_atomically

SUFFIX = ".pbrt"
DEPTH = 1000
"""Bounces after which a path of pbrt's ends; its default is 5."""


def write(scene: Scene, path: Path) -> list[str]:
    """Write a scene for pbrt-v4, a sky's image as NAME.sky.exr beside it; return what it does not say."""
    refuse_images(scene, "pbrt")
    described = describe(scene, sky_file=f"{path.stem}.sky.exr")
    missing = described["left_out"] + left_out(described)
    lines = [f"# {described['name']}, for pbrt-v4; written by Termwise, which has not run pbrt. Not in this file:"]
    lines += [f"#   {' '.join(line.split())}" for line in missing]
    lines += _head(described, path)
    for light in described["lights"]:
        lines += _sphere(light) if light["type"] == "sphere" else [_light(light)]
    sky = described["sky"]
    if sky is not None and sky["type"] == "constant":
        lines.append(f'LightSource "infinite" "rgb L" [ {_values(sky["radiance"])} ]')
    elif sky is not None:
        texels = panorama.equal_area_square(scene.sky, scene.camera.position)
        write_atomically(path.with_name(sky["file"]), lambda temporary: openexr.write(temporary, texels))
        lines.append(f'LightSource "infinite" "string filename" [ {_quoted(sky["file"])} ]')
    for thing in described["objects"]:
        lines += _object(thing)
    write_atomically(path, lambda temporary: temporary.write_text("\n".join(lines) + "\n", "utf-8"))
    return missing


def left_out(described: dict[str, Any]) -> list[str]:
    """What pbrt cannot say of a scene described."""
    found = []
    for thing in described["objects"]:
        material = thing["material"]
        of = f"objects: {thing['name']!r}"
        if "transparency" in material:
            found.append(f"{of}: fresnel = 'dielectric': the lobes are GGX's of the same alpha, not Beckmann's")
        elif material["gloss"] > 0.0:
            whose = "a dielectric's" if "fresnel" in material else "Schlick's"
            found.append(
                f"{of}: gloss = {material['gloss']!r}: the lobe is GGX's of the same alpha with a conductor's Fresnel "
                f"of the same f0, not Beckmann's with {whose}"
            )
        if "transparency" in material and {material["gloss"], material["transparency"], *material["tint"]} != {1.0}:
            said = f"gloss = {material['gloss']!r}, transparency = {material['transparency']!r}, tint"
            found.append(
                f"{of}: {said} = {material['tint']!r}: pbrt's dielectric loses nothing: all are 1 in its lobes"
            )
    materials = [thing["material"] for thing in described["objects"]]
    if any(len(set(material["color"])) > 1 for material in materials):
        found.append(
            "objects: color: pbrt makes smooth spectra of them, whose product is not the product of the colours"
        )
    for number, light in enumerate(described["lights"]):
        if light["type"] == "spot":
            found.append(f"lights[{number}]: spot: pbrt's falls as a smooth step of the cosine from beam to cutoff")
        if light["type"] == "sun":
            found.append(f"lights[{number}]: sun: a distant light without a disc")
    if described["sky"] is not None and described["sky"]["type"] == "image":
        found.append("sky: resampled as the camera sees it, and infinitely far: texels of pbrt's are not interpolated")
    return found


def _head(described: dict[str, Any], path: Path) -> list[str]:
    """All that stands before the world."""
    camera, (width, height) = described["camera"], described["film"]["resolution"]
    target = [p + f for p, f in zip(camera["position"], camera["forward"], strict=True)]
    across = math.tan(math.radians(camera["horizontal_fov"]) / 2.0)
    fov = 2.0 * math.degrees(math.atan(across * min(1.0, height / width)))
    return [
        "",
        "Scale -1 1 1",
        f"LookAt {_values(camera['position'])}",
        f"       {_values(target)}",
        f"       {_values(camera['up'])}",
        f'Camera "perspective" "float fov" [ {fov!r} ]',
        f'Film "rgb" "integer xresolution" [ {width} ] "integer yresolution" [ {height} ] '
        f'"string filename" [ {_quoted(path.stem + ".exr")} ] "bool savefp16" [ false ]',
        'PixelFilter "box" "float xradius" [ 0.5 ] "float yradius" [ 0.5 ]',
        'Sampler "independent" "integer pixelsamples" [ 64 ]',
        f'Integrator "path" "integer maxdepth" [ {DEPTH} ]',
        "",
        "WorldBegin",
        "",
    ]


def _sphere(light: dict[str, Any]) -> list[str]:
    return [
        "AttributeBegin",
        f"  Translate {_values(light['center'])}",
        '  Material "diffuse" "rgb reflectance" [ 0 0 0 ]',
        f'  AreaLightSource "diffuse" "rgb L" [ {_values(light["radiance"])} ]',
        f'  Shape "sphere" "float radius" [ {light["radius"]!r} ]',
        "AttributeEnd",
    ]


def _light(light: dict[str, Any]) -> str:
    if light["type"] in ("directional", "sun"):
        back = [-component for component in light["direction"]]
        source = f'LightSource "distant" "rgb L" [ {_values(light["irradiance"])} ]'
        return f'{source} "point3 from" [ {_values(back)} ] "point3 to" [ 0 0 0 ]'
    source = f'LightSource "{light["type"]}" "rgb I" [ {_values(light["intensity"])} ]'
    source += f' "point3 from" [ {_values(light["position"])} ]'
    if light["type"] == "spot":
        to = [p + a for p, a in zip(light["position"], light["axis"], strict=True)]
        source += f' "point3 to" [ {_values(to)} ] "float coneangle" [ {light["cutoff"]!r} ]'
        source += f' "float conedeltaangle" [ {light["cutoff"] - light["beam"]!r} ]'
    return source


def _object(thing: dict[str, Any]) -> list[str]:
    lines = ["", f"# {' '.join(thing['name'].split())}", "AttributeBegin", *_material(thing)]
    if any(thing["emission"]):
        lines.append(f'  AreaLightSource "diffuse" "rgb L" [ {_values(thing["emission"])} ]')
    lines += ['  Shape "trianglemesh"', '    "point3 P" [', *_rows(thing["vertices"]), "    ]"]
    if thing["normals"] is not None:
        lines += ['    "normal N" [', *_rows(thing["normals"]), "    ]"]
    return [*lines, '    "integer indices" [', *_rows(thing["faces"]), "    ]", "AttributeEnd"]


def _material(thing: dict[str, Any]) -> list[str]:
    material = thing["material"]
    share = material.get("translucency", 0.0)
    kept, crossing = ([part * color for color in material["color"]] for part in (1.0 - share, share))
    kind, diffuse = "diffuse", f'"rgb reflectance" [ {_values(kept)} ]'
    if share:
        kind, diffuse = "diffusetransmission", f'{diffuse} "rgb transmittance" [ {_values(crossing)} ]'
    # What is not diffuse: gloss, and of a transparent surface all that goes through besides.
    lobes = 1.0 - (1.0 - material["gloss"]) * (1.0 - material.get("transparency", 0.0))
    if lobes == 0.0:
        return [f'  Material "{kind}" {diffuse}']
    shape = f'"float roughness" [ {material["roughness"]!r} ] "bool remaproughness" [ false ]'
    if "transparency" in material:
        name, lobe = "dielectric", f'"float eta" [ {material["ior"]!r} ] {shape}'
    elif "ior" in material:
        name, lobe = "conductor", f'"rgb reflectance" [ {_values([_f0(material["ior"])] * 3)} ] {shape}'
    else:
        name, lobe = "conductor", f'"rgb reflectance" [ {_values(material["f0"])} ] {shape}'
    if lobes == 1.0 and name == "dielectric":
        return [f'  Material "dielectric" {lobe}']
    names = [_quoted(f"{thing['name']}: {part}") for part in ("diffuse", "lobe")]
    return [
        f'  MakeNamedMaterial {names[0]} "string type" [ "{kind}" ] {diffuse}',
        f'  MakeNamedMaterial {names[1]} "string type" [ "{name}" ] {lobe}',
        f'  Material "mix" "string materials" [ {" ".join(names)} ] "float amount" [ {lobes!r} ]',
    ]


def _f0(ior: float) -> float:
    """Reflectance of a dielectric at normal incidence, of which pbrt makes a conductor."""
    return ((ior - 1.0) / (ior + 1.0)) ** 2


def _quoted(text: str) -> str:
    r"""A string of pbrt's, whose tokens may have \" and \\ in them."""
    plain = " ".join(text.split())
    return '"' + plain.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _values(values: list[float]) -> str:
    return " ".join(repr(value) for value in values)


def _rows(values: list[list[float]]) -> list[str]:
    return [f"      {_values(row)}" for row in values]
