"""A scene from OBJ with its MTL: an object for each name and material; `Kd` reflects, `Ke` is the radiance of a lamp.

Either is times the image of its map. Coordinates stay as they are. OBJ has no camera, point light or sky; what is
assumed in their place is listed. The camera of our own export is read from its comment.
"""

import re
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.scenes.exchange.imported import MIRROR, Import, look
from termwise.scenes.meshes import obj
from termwise.scenes.meshes.polygons import triangulate
from termwise.scenes.model import BLACK, Color, Material, Scene
from termwise.scenes.strict import FileError
from termwise.scenes.textures import Texture, read_color

_TRANSMITS = (4, 6, 7, 9)
"""Values of `illum` that mean glass or refraction."""
_THREE = r"\S+ \S+ \S+"
_CAMERA = re.compile(
    rf"^# camera: at (?P<position>{_THREE}), forward (?P<forward>{_THREE}), up (?P<up>{_THREE}), "
    r"(?P<fov>\S+) degrees across, (?P<width>\d+) x (?P<height>\d+) pixels: ",
    re.MULTILINE,
)
"""As `exchange.obj` writes it."""
_HEAD = 65536
"""Bytes in which that comment is."""
_PLAIN = (0, 1)
"""Values of `illum` that mean no highlight."""
_IMAGES = {"map_Kd": "Kd", "map_Ke": "Ke"}
"""Maps that are read, and what they are times."""


@attrs.define
class _Look:
    """A material of MTL, as far as it is read."""

    name: str
    Kd: Color | None = None
    Ks: Color = BLACK
    Ke: Color | None = None
    Ns: float = 0.0
    illum: int | None = None
    opacity: float = 1.0
    maps: dict[str, Path] = attrs.Factory(dict)
    altered: set[str] = attrs.Factory(set)
    """Maps that are said with options."""


def read(path: Path, *, approximate: bool) -> Scene:
    """Read a scene, see `scenes.load.load`."""
    found = Import(path, approximate)
    content = obj.parse(path)
    looks: dict[str, _Look] = {}
    for library in content.libraries:
        looks |= _library(path.parent / library)
    if any({*_IMAGES} & {*look.maps} for look in looks.values()):
        content = obj.parse(path, mapped=True)
    pairs = [*zip(content.objects, content.materials, strict=True)]
    starts = np.cumsum(content.counts) - content.counts
    distinct = [*dict.fromkeys(pairs)]
    for thing, used in distinct:
        name = thing or used
        if thing and sum(each[0] == thing for each in distinct) > 1:
            name = f"{thing}: {used}"
        chosen = np.flatnonzero([pair == (thing, used) for pair in pairs])
        corners = np.concatenate([np.arange(starts[i], starts[i] + content.counts[i]) for i in chosen])
        _object(found, content, name, corners, content.counts[chosen], looks, used)
    _camera(found)
    return found.scene()


def _camera(found: Import) -> None:
    """The camera and the size of the picture that `exchange.obj` writes into a comment."""
    with found.path.open("rb") as file:
        head = file.read(_HEAD).decode("utf-8", "replace")
    said = _CAMERA.search(head)
    if said is None:
        return
    position, forward, up = ([float(each) for each in said[name].split()] for name in ("position", "forward", "up"))
    found.camera = look(position, forward, up, float(said["fov"]))
    found.resolution = int(said["width"]), int(said["height"])


def _object(
    found: Import,
    content: obj.Content,
    name: str,
    corners: np.ndarray,
    counts: np.ndarray,
    looks: dict[str, _Look],
    used: str,
) -> None:
    """Add the polygons of one object and material."""
    if used and used not in looks:
        raise FileError(f"{found.path}: usemtl {used}: no such material: allowed are {', '.join(looks) or 'none'}")
    if not used:
        found.assume(f"{name or 'what has no material'}: a diffuse surface of reflectance 0.8")
    points, shading, places = content.corners[corners], content.shading[corners], content.mapped[corners]
    mapped = bool((places >= 0).all())
    material, emission = _surface(found, looks[used], mapped) if used else (Material(), BLACK)
    smooth = bool((shading >= 0).all())
    if not smooth:
        if (shading >= 0).any():
            found.instead(name, "normals at some corners alone", "those of the faces")
        shading = np.full_like(shading, -1)
    # A vertex for each point with each of its normals.
    pairs, indices = np.unique(np.stack([points, shading], axis=1), axis=0, return_inverse=True)
    vertices = content.points[pairs[:, 0]]
    # By corners, for a vertex may lie in several places of an image.
    triangles = triangulate(content.points[points], np.arange(len(points)), counts)
    normals = content.normals[pairs[:, 1]] if smooth else None
    laid = bool(material.textures) or isinstance(emission, Texture)
    uv = content.places[places[triangles]] if laid else None
    found.add(name, vertices, indices.ravel()[triangles], material, normals=normals, emission=emission, uv=uv)


def _surface(found: Import, look: _Look, mapped: bool) -> tuple[Material, Color | Texture]:
    """Surface and radiance of a material; Phong's lobe becomes one of Beckmann's of the same width and reflectance.

    `mapped`: whether all corners have a place in an image.
    """
    name = f"material {look.name!r}"
    if look.illum in _TRANSMITS:
        found.instead(name, f"illum {look.illum}, which transmits light", "an opaque surface")
    if look.opacity < 1.0:
        found.instead(name, f"an opacity of {look.opacity:g}", "an opaque surface")
    diffuse, radiance = (_values(found, look, feature, mapped) for feature in _IMAGES)
    if look.Kd is None and not radiance.any() and "map_Kd" not in look.maps:
        found.assume(f"{name} is black, for it has no Kd")
    for feature in look.maps:
        if feature not in _IMAGES:
            found.instead(name, feature, "the material without it")
    emission = _color(radiance) if radiance.any() else BLACK
    if not any(look.Ks) or look.illum in _PLAIN:
        return Material(_color(diffuse), 0.0), emission
    gloss = max(look.Ks)
    found.instead(
        name, f"Phong's lobe, Ks {' '.join(map(str, look.Ks))}, Ns {look.Ns:g}", "Beckmann's of about its width"
    )
    under = _color(np.minimum(diffuse / (1.0 - gloss), 1.0) if gloss < 1.0 else 0.0 * diffuse)
    alpha = float(np.clip(np.sqrt(2.0 / (look.Ns + 2.0)), MIRROR, 1.5))
    return Material(under, gloss, alpha, tuple(min(s / gloss, 1.0) for s in look.Ks)), emission


def _values(found: Import, look: _Look, feature: str, mapped: bool) -> np.ndarray:
    """Three numbers, or (H, W, 3), as many for each texel: what a map says times what the material says."""
    given = getattr(look, _IMAGES[feature])
    if feature not in look.maps:
        return np.array(given or BLACK)
    texels = _texels(look.maps[feature])
    if not mapped or feature in look.altered:
        unsaid = "with options" if mapped else "without vt at all corners"
        found.instead(f"material {look.name!r}", f"{feature} {unsaid}", "its mean")
        texels = texels.mean(axis=(0, 1))
    return texels if given is None else np.array(given) * texels


def _color(values: np.ndarray) -> Color | Texture:
    """A colour, or an image of texels (H, W, 3)."""
    if values.ndim == 3:
        return Texture(values)
    red, green, blue = values.tolist()
    return red, green, blue


def _texels(path: Path) -> np.ndarray:
    """Of an image, (H, W, 3), linear."""
    try:
        return read_color(path, None).astype(np.float64)
    except ValueError as error:
        raise FileError(f"{path}: {error}") from None


def _library(path: Path) -> dict[str, _Look]:
    """Materials of an MTL file by name."""
    looks: dict[str, _Look] = {}
    look = None
    for line, statement in obj.statements(path.read_bytes().decode("utf-8-sig", "replace")):
        word, *values = statement.split()
        if word == "newmtl":
            look = looks[" ".join(values)] = _Look(" ".join(values))
        elif look is None:
            raise FileError(f"{path}: line {line}: {statement[:60]!r}: stands before the first newmtl")
        else:
            try:
                _property(look, path, word, values)
            except (ValueError, IndexError):
                raise FileError(
                    f"{path}: line {line}: {statement[:60]!r}: allowed are numbers, three of a colour"
                ) from None
    return looks


def _property(look: _Look, path: Path, word: str, values: list[Any]) -> None:
    if word in ("Kd", "Ks", "Ke"):
        numbers = [float(value) for value in values]
        red, green, blue = numbers if len(numbers) > 1 else numbers * 3
        setattr(look, word, (red, green, blue))
    elif word == "Ns":
        look.Ns = float(values[0])
    elif word == "illum":
        look.illum = int(values[0])
    elif word == "d":
        look.opacity = float(values[-1])
    elif word == "Tr":
        look.opacity = 1.0 - float(values[0])
    elif word.startswith("map_") or word in ("bump", "disp", "norm", "decal"):
        look.maps[word] = path.parent / values[-1]
        look.altered |= {word} if len(values) > 1 else set()
