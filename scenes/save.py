"""`save(scene, path)`: a scene as a file that `load` reads back with the same digest.

Only fields that differ from their default are written. A parallelogram stays a `rectangle` where its corners come out
the same to the bit; other meshes go as binary PLY, images as OpenEXR, into the folder `NAME.files` beside it. A uv
that no image asks for is not written.
"""

from pathlib import Path
from typing import Any

import attrs
import numpy as np
import tomli_w

from termwise.scenes.images import openexr
from termwise.scenes.load import UNIT_SQUARE, load
from termwise.scenes.meshes import ply
from termwise.scenes.model import Ambient, Light, Material, Mesh, Object, Photons, PointLight, Scene, Sky, Toggles
from termwise.scenes.store import write_atomically
from termwise.scenes.textures import Texture, in_color

_QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def save(scene: Scene, path: Path) -> None:
    """Write a scene; all files appear whole or not at all, the TOML file last.

    Raises
    ------
    ValueError : the name does not end in .toml, or is one that would not be read back; a mesh has normals of its own,
        which no field of a scene file says.
    """
    scene = attrs.evolve(scene, objects=tuple(map(_asked_for, scene.objects)))
    if path.suffix != ".toml" or path.stem.startswith("."):
        raise ValueError(f"{path}: allowed is a name that ends in .toml")
    for thing in scene.objects:
        mesh = thing.mesh
        if mesh.normals is not None and not _smooth(mesh):
            raise ValueError(
                f"{path}: objects: {thing.name!r}: normals are of another file: allowed are flat or smooth ones"
            )
    files = path.with_suffix(".files")
    table: dict[str, Any] = {}
    for field in attrs.fields(Scene):
        value = getattr(scene, field.name)
        if field.name in ("name", "camera", "objects", "lights", "ambient", "sky", "photons", "toggles"):
            continue
        if value != field.default:
            table[field.name] = _plain(value)
    camera = {name: _plain(value) for name, value in attrs.asdict(scene.camera).items()}
    table["camera"] = camera
    for name, default in (("ambient", Ambient()), ("photons", Photons()), ("toggles", Toggles())):
        if changed := _changed(getattr(scene, name), default):
            table[name] = changed
    if sky := _sky(scene.sky, files):
        table["sky"] = sky
    table["objects"] = [_object(thing, number, files) for number, thing in enumerate(scene.objects)]
    table["lights"] = [_light(light) for light in scene.lights]
    text = tomli_w.dumps({name: value for name, value in table.items() if value != []})
    write_atomically(path, lambda temporary: temporary.write_text(text, "utf-8"))
    assert load(path).digest() == scene.digest(), path


def _asked_for(thing: Object) -> Object:
    """An object without what no file would say of it."""
    unread = thing.mesh.uv is not None and not thing.images
    return attrs.evolve(thing, mesh=attrs.evolve(thing.mesh, uv=None)) if unread else thing


def _smooth(mesh: Mesh) -> bool:
    """Whether shading normals are those that a scene file means by smooth."""
    normals = Mesh.from_arrays(mesh.vertices, mesh.faces, smooth=True).normals
    return normals is not None and mesh.normals is not None and np.array_equal(normals, mesh.normals)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _changed(value: Any, default: Any) -> dict[str, Any]:
    """Fields of a flat value that differ from the default's."""
    fields = ((field.name, getattr(value, field.name)) for field in attrs.fields(type(value)))
    return {name: _plain(item) for name, item in fields if item != getattr(default, name)}


def _sky(sky: Sky, files: Path) -> dict[str, Any]:
    table = {
        name: _plain(getattr(sky, name))
        for name in ("center", "radius", "projection")
        if getattr(sky, name) != getattr(Sky(), name)
    }
    if sky.texture is None:
        return {"color": list(sky.color), **table} if table or any(sky.color) else {}
    pixels = sky.texture
    write_atomically(files / "sky.exr", lambda temporary: openexr.write(temporary, pixels))
    return {"texture": f"{files.name}/sky.exr", **table}


def _light(light: Light) -> dict[str, Any]:
    table = {} if isinstance(light, PointLight) else {"kind": light.kind}
    fields = ((field, getattr(light, field.name)) for field in attrs.fields(type(light)))
    return table | {field.name: _plain(value) for field, value in fields if value != field.default}


def _object(thing: Object, number: int, files: Path) -> dict[str, Any]:
    table: dict[str, Any] = {"name": thing.name, **_shape(thing.mesh, number, files)}
    if thing.mesh.normals is not None:
        table["normals"] = "smooth"
    table |= _changed(thing.material, Material())
    table |= {name: _image(image, f"{number:02d}.{name}.exr", files) for name, image in thing.material.textures.items()}
    if isinstance(thing.emission, Texture):
        table["emission"] = _image(thing.emission, f"{number:02d}.emission.exr", files)
    elif thing.emits:
        table["emission"] = list(thing.emission)
    return table


def _image(texture: Texture, name: str, files: Path) -> dict[str, Any]:
    write_atomically(files / name, lambda temporary: openexr.write(temporary, in_color(texture.texels)))
    return {"file": f"{files.name}/{name}"} | ({} if texture.wrap == "repeat" else {"wrap": texture.wrap})


def _shape(mesh: Mesh, number: int, files: Path) -> dict[str, Any]:
    if np.array_equal(mesh.faces, _QUAD) and len(mesh.vertices) == 4:
        origin, first, _, last = mesh.vertices
        edges = first - origin, last - origin
        corners = origin, origin + edges[0], origin + edges[0] + edges[1], origin + edges[1]
        lies = mesh.uv is None or np.array_equal(mesh.uv, UNIT_SQUARE[_QUAD])
        if lies and np.array_equal(np.array(corners, np.float32), mesh.vertices):
            return {"shape": "rectangle", "origin": origin.tolist(), "edges": [e.tolist() for e in edges]}
    name = f"{number:02d}.ply"
    write_atomically(
        files / name,
        lambda temporary: ply.write(temporary, mesh.vertices, None, mesh.faces, uv=mesh.uv, by_vertex=False),
    )
    return {"shape": "mesh", "file": f"{files.name}/{name}"}
