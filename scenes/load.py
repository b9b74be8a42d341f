"""`load(name or path) -> Scene`: the library's scenes, the user's TOML files, and files of other renderers.

A scene file holds the fields of `Scene`, its tables `camera`, `ambient`, `sky`, `photons` and `toggles`, and the
arrays of tables `objects` and `lights`. Every object names a `shape` (`rectangle`, `box`, `sphere`, `mesh`) and is
placed by `scale`, then `rotation` (degrees about x, then y, then z), then `translation`. A light names its `kind`,
but for `point`.
Errors are one line: file, field, value, and what is allowed.
"""

import importlib
import math
from pathlib import Path
from typing import Any, ClassVar, Literal, cast, get_args

import attrs
import numpy as np

from termwise.scenes import images, meshes, model, strict, textures
from termwise.scenes.strict import FileError
from termwise.scenes.textures import Texture

UNIT_SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
"""Where in an image the corners of a rectangle lie."""
LIBRARY = Path(__file__).parent / "library"
READERS = {
    ".glb": "termwise.scenes.exchange.from_gltf",
    ".obj": "termwise.scenes.exchange.from_obj",
    ".xml": "termwise.reference.from_xml",
}
"""Modules that read other renderers' scenes, by the end of the name: each has `read(path, approximate=)`.

By name, for this folder knows no Mitsuba, which reads its own XML.
"""


def library() -> tuple[str, ...]:
    """Names of the scenes that ship with Termwise."""
    return tuple(sorted(path.stem for path in LIBRARY.glob("*.toml")))


def load(scene: str | Path | model.Scene, *, approximate: bool = False) -> model.Scene:
    """Load a scene of the library by name, or any scene file by path; a scene is given back as it is.

    Parameters
    ----------
    scene : a name of the library, or the path of a file: TOML, Mitsuba's XML, GLB, OBJ.
    approximate : whether the nearest thing that the model has may stand for what it cannot say of another renderer's
        scene; the scene's `substitutions` list each.

    Raises
    ------
    FileError : a missing or malformed file, an unknown key, a value out of range, a mesh that is none; something that
        the model cannot say.
    """
    if isinstance(scene, model.Scene):
        return scene
    path = LIBRARY / f"{scene}.toml" if str(scene) in library() else Path(scene)
    if path.suffix.lower() in READERS:
        return _foreign(path, approximate)
    if path.suffix != ".toml":
        raise FileError(
            f"{scene}: no such scene: allowed are {', '.join(library())} or a path that ends in "
            f".toml, {', '.join([*READERS][:-1])} or {[*READERS][-1]}"
        )
    description = strict.read(path, _SceneFile, _converter)
    try:
        return description.build(path)
    except ValueError as error:
        raise FileError(f"{path}: {error}") from None


def _foreign(path: Path, approximate: bool) -> model.Scene:
    """A scene of another renderer; every fault of its file is one line."""
    if not path.is_file():
        raise FileError(f"{path}: cannot be read: no such file")
    reader = importlib.import_module(READERS[path.suffix.lower()])
    try:
        return reader.read(path, approximate=approximate)
    except FileError:
        raise
    except ValueError as error:
        raise FileError(f"{path}: {error}") from None
    except OSError as error:
        raise FileError(f"{error.filename or path}: cannot be read: {error.strerror or error}") from None


@attrs.frozen(kw_only=True)
class _Image:
    """An image in the place of a colour, of a radiance, `scale` times it, or, by its one `channel`, of a number."""

    file: str
    wrap: textures.Wrap = "repeat"
    encoding: textures.Encoding | None = None
    channel: textures.Channel | None = None
    scale: float | None = attrs.field(default=None, validator=attrs.validators.optional(model.positive))

    def read(self, folder: Path, name: str) -> Texture:
        """The image as the field `name`.

        Raises
        ------
        ValueError : which field, which file, and why it cannot be read.
        """
        path = folder / self.file
        try:
            if not path.is_file():
                raise ValueError(f"no such file in {folder}")
            colored = name in ("color", "emission")
            if colored and self.channel is not None:
                raise ValueError(f"channel = {self.channel!r}: allowed is none, for a colour has all")
            if name != "emission" and self.scale is not None:
                raise ValueError(f"scale = {self.scale!r}: allowed is none, but of emission")
            texels = (
                textures.read_color(path, self.encoding)
                if colored
                else textures.read_number(path, self.encoding, self.channel)
            )
            if self.scale is not None:
                texels = texels * np.float64(self.scale)
            texture = Texture(texels, self.wrap)
            # Where its texels are refused, the file is named.
            if name == "emission":
                model.non_negative(None, attrs.fields(model.Object).emission, texture)
            else:
                model.Material(**cast(Any, {name: texture}))
            return texture
        except ValueError as error:
            raise ValueError(f"{name} = {self.file!r}: {str(error).removeprefix(f'{name}: ')}") from None


@attrs.frozen(kw_only=True)
class _Placed:
    """What all shapes have in common."""

    shape: ClassVar[str]
    name: str
    scale: float = attrs.field(default=1.0, validator=model.positive)
    rotation: model.Vector = attrs.field(default=(0.0, 0.0, 0.0), validator=model.finite)
    translation: model.Vector = attrs.field(default=(0.0, 0.0, 0.0), validator=model.finite)
    normals: Literal["flat", "smooth"] = "flat"
    color: model.Color | _Image = cast(model.Color, model.Material().color)
    gloss: float | _Image = cast(float, model.Material().gloss)
    roughness: float | _Image = cast(float, model.Material().roughness)
    f0: model.Color = model.Material().f0
    translucency: float = model.Material().translucency
    transparency: float = model.Material().transparency
    ior: float = model.Material().ior
    tint: model.Color = model.Material().tint
    fresnel: model.Fresnel = model.Material().fresnel
    occludes: bool = model.Material().occludes
    emission: model.Color | _Image = cast(model.Color, model.BLACK)

    def __attrs_post_init__(self) -> None:
        """Check material and emission where their fields stand in the file."""
        model.Material(**{name: value for name, value in self.looks().items() if not isinstance(value, _Image)})
        if not isinstance(self.emission, _Image):
            model.non_negative(self, attrs.fields(model.Object).emission, self.emission)

    def looks(self) -> dict[str, Any]:
        """Fields of the material."""
        return {field.name: getattr(self, field.name) for field in attrs.fields(model.Material)}

    def material(self, folder: Path) -> model.Material:
        """The material with its images."""
        try:
            read: dict[str, Any] = {
                name: value.read(folder, name) if isinstance(value, _Image) else value
                for name, value in self.looks().items()
            }
            return model.Material(**read)
        except ValueError as error:
            raise ValueError(f"objects: {self.name!r}: {error}") from None

    def sent(self, folder: Path) -> model.Color | Texture:
        """The emission with its image."""
        if not isinstance(self.emission, _Image):
            return self.emission
        try:
            return self.emission.read(folder, "emission")
        except ValueError as error:
            raise ValueError(f"objects: {self.name!r}: {error}") from None

    def geometry(self, folder: Path, *, mapped: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Vertices (V, 3) and faces (F, 3) before placement, and where in an image the faces' corners lie, (F, 3, 2).

        None where nothing says that, or it is not to be `mapped`.
        """
        raise NotImplementedError

    def where(self) -> str:
        """Beginning of a message about this object's geometry."""
        return f"objects: {self.name!r}"

    def build(self, folder: Path) -> model.Object:
        material, emission = self.material(folder), self.sent(folder)
        reflects = not any(model.largest(emission))
        mapped = isinstance(emission, Texture) or (reflects and bool(material.textures))
        vertices, faces, uv = self.geometry(folder, mapped=mapped)
        with np.errstate(over="ignore", invalid="ignore"):  # the mesh refuses what is not finite
            placed = self.scale * np.asarray(vertices, np.float64) @ self._rotation().T + self.translation
        try:
            mesh = model.Mesh.from_arrays(placed, faces, smooth=self.normals == "smooth", uv=uv)
        except ValueError as error:
            raise ValueError(f"{self.where()}: {error}") from None
        try:
            return model.Object(self.name, mesh, material, emission)
        except ValueError as error:
            raise ValueError(f"objects: {error}") from None

    def _rotation(self) -> np.ndarray:
        from trimesh import transformations  # here, as below: it takes seconds to load, and `judge` reads no shapes

        about_x, about_y, about_z = (math.radians(angle) for angle in self.rotation)
        return transformations.euler_matrix(about_x, about_y, about_z, "sxyz")[:3, :3]


@attrs.frozen(kw_only=True)
class _Rectangle(_Placed):
    """A parallelogram; its normal is edges[0] x edges[1]. An image has its u along the one, its v along the other."""

    shape: ClassVar[str] = "rectangle"
    origin: model.Vector = attrs.field(default=(0.0, 0.0, 0.0), validator=model.finite)
    edges: tuple[model.Vector, model.Vector]

    def geometry(self, folder: Path, *, mapped: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        corner = np.asarray(self.origin)
        first, second = np.asarray(self.edges)
        if not np.linalg.norm(np.cross(first, second)) > 0:
            raise ValueError(f"{self.where()}: edges = {self.edges!r}: allowed are two that span an area")
        vertices = np.array([corner, corner + first, corner + first + second, corner + second])
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        return vertices, faces, UNIT_SQUARE[faces] if mapped else None


@attrs.frozen(kw_only=True)
class _Box(_Placed):
    """An axis-aligned box around the origin, normals outwards."""

    shape: ClassVar[str] = "box"
    size: model.Vector = attrs.field(validator=model.positive)

    def geometry(self, folder: Path, *, mapped: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        from trimesh import creation

        box = creation.box(extents=self.size)
        return box.vertices, box.faces, None


@attrs.frozen(kw_only=True)
class _Sphere(_Placed):
    """An icosphere around the origin, vertices on the sphere, normals outwards."""

    shape: ClassVar[str] = "sphere"
    radius: float = attrs.field(default=1.0, validator=model.positive)
    subdivisions: int = attrs.field(default=3, validator=model.in_range(0, 8))

    def geometry(self, folder: Path, *, mapped: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        from trimesh import creation

        sphere = creation.icosphere(subdivisions=self.subdivisions, radius=self.radius)
        return sphere.vertices, sphere.faces, None


@attrs.frozen(kw_only=True)
class _MeshFile(_Placed):
    """A PLY, OBJ, STL or GLB file beside the scene file; polygons are triangulated."""

    shape: ClassVar[str] = "mesh"
    file: str

    def where(self) -> str:
        return f"objects: {self.name!r}: file = {self.file!r}"

    def geometry(self, folder: Path, *, mapped: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        path = folder / self.file
        where = self.where()
        if path.suffix.lower() not in meshes.READERS:
            *others, last = meshes.READERS
            raise ValueError(f"{where}: allowed are files that end in {', '.join(others)} or {last}")
        if not path.is_file():
            raise ValueError(f"{where}: no such file in {folder}")
        try:
            return meshes.read_mapped(path) if mapped else (*meshes.read(path), None)
        except meshes.MeshError as error:
            raise ValueError(f"{where}: {error}") from None
        except OSError as error:
            raise ValueError(f"{where}: cannot be read: {error.strerror or error}") from None


_SHAPES: dict[str, type[_Placed]] = {kind.shape: kind for kind in (_Rectangle, _Box, _Sphere, _MeshFile)}


@attrs.frozen(kw_only=True)
class _SkyFile:
    """A sky as the file says it: a colour or the name of a texture."""

    color: model.Color | None = None
    texture: str | None = None
    center: model.Vector = model.Sky().center
    radius: float = model.Sky().radius
    projection: Literal["equal-area", "lat-long"] = "equal-area"

    def __attrs_post_init__(self) -> None:
        """Refuse a sky that is both or neither."""
        if (self.color is None) == (self.texture is None):
            raise ValueError(f"color = {self.color!r}, texture = {self.texture!r}: allowed is one of the two")

    def build(self, folder: Path) -> model.Sky:
        placed = model.Sky(center=self.center, radius=self.radius, projection=self.projection)
        if self.texture is None:
            return attrs.evolve(placed, color=self.color or model.BLACK)
        return attrs.evolve(placed, texture=_read_texture(folder, self.texture))


def _read_texture(folder: Path, name: str) -> np.ndarray:
    where = f"sky: texture = {name!r}"
    path = folder / name
    if not path.is_file():
        raise ValueError(f"{where}: no such file in {folder}")
    try:
        texture = np.ascontiguousarray(images.read_one(path).pixels, np.float32)
    except ValueError as error:
        raise ValueError(f"{where}: {str(error).removeprefix(f'{path}: ')}") from None
    if not (np.isfinite(texture).all() and (texture >= 0).all()):
        raise ValueError(f"{where}: holds NaN, infinite or negative texels: allowed are finite ones >= 0")
    return texture


@attrs.frozen(kw_only=True)
class _SceneFile:
    """The top level of a scene file."""

    camera: model.Camera
    objects: tuple[_Placed, ...] = ()
    lights: tuple[model.Light, ...] = ()
    ambient: model.Ambient = model.Ambient()
    sky: _SkyFile | None = None
    photons: model.Photons = model.Photons()
    toggles: model.Toggles = model.Toggles()
    resolution: tuple[int, int] = (128, 128)
    exposure: float = 1.0
    max_bounces: int = 2
    rings: int = 16
    scope: model.Scope = "all"
    shadows: Literal["physical", "paper"] = "physical"
    irradiance: Literal["E / pi", "E"] = "E / pi"
    ignore: Literal["face", "object"] = "face"
    normals: Literal["viewer", "face"] = "viewer"
    intersection: Literal["watertight", "paper"] = "watertight"
    draw_lights: bool = False
    substitutions: tuple[str, ...] = ()

    def build(self, path: Path) -> model.Scene:
        fields = attrs.asdict(self, recurse=False)
        fields["objects"] = tuple(item.build(path.parent) for item in self.objects)
        fields["sky"] = self.sky.build(path.parent) if self.sky else model.Sky()
        return model.Scene(name=path.stem, **fields)


def _light(value: Any, _kind: Any) -> model.Light:
    if not isinstance(value, dict):
        raise TypeError("a table")
    if "type" in value and "kind" not in value:
        raise ValueError(f"type = {value['type']!r}: unknown key: allowed is kind, one of {', '.join(model.LIGHTS)}")
    name = value.get("kind", model.PointLight.kind)
    kind = model.LIGHTS.get(name) if isinstance(name, str) else None
    if kind is None:
        raise ValueError(f"kind = {name!r}: allowed are {', '.join(model.LIGHTS)}")
    return _converter.structure({key: item for key, item in value.items() if key != "kind"}, kind)


def _shape(value: Any, _kind: type) -> _Placed:
    if not isinstance(value, dict):
        raise TypeError("a table")
    if "shape" not in value:
        raise ValueError(f"shape: is missing: allowed are {', '.join(_SHAPES)}")
    kind = _SHAPES.get(value["shape"]) if isinstance(value["shape"], str) else None
    if kind is None:
        raise ValueError(f"shape = {value.get('shape')!r}: allowed are {', '.join(_SHAPES)}")
    return _converter.structure({key: item for key, item in value.items() if key != "shape"}, kind)


def _or_image(value: Any, kind: Any) -> Any:
    if isinstance(value, dict):
        return _converter.structure(value, _Image)
    try:
        return _converter.structure(value, get_args(kind)[0])
    except TypeError as error:
        raise TypeError(f"{error}, or a table with the file of an image") from None


_converter = strict.converter()
_converter.register_structure_hook_func(lambda kind: kind in (model.Color | _Image, float | _Image), _or_image)
_converter.register_structure_hook_func(lambda kind: kind is _Placed, _shape)
_converter.register_structure_hook_func(lambda kind: kind == model.Light, _light)
