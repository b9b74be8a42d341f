"""The scene: triangle meshes with materials, lights, a sky, an ambient light and a near-plane camera.

The camera is the paper's: the near plane at distance `near` is `width = 2 near tan(fov / 2)` wide and
`height = width / aspect` high; it is cut into pixels and a ray leaves the camera towards a point of each.

Everything is validated here, at the gate, once for both sides; a ValueError names the field, the value and
what is allowed. Lengths are in scene units, angles in degrees, radiance in one linear Rec. 709 unit.
"""

import hashlib
import math
import numbers
from collections.abc import Callable
from typing import Any, ClassVar, Literal, cast, get_args

import attrs
import numpy as np

from termwise.scenes import coincident
from termwise.scenes.textures import Texture

Vector = tuple[float, float, float]
Color = tuple[float, float, float]
Scope = Literal["first-hit", "all"]

BLACK: Color = (0.0, 0.0, 0.0)


def _refuse(attribute: attrs.Attribute, value: object, allowed: str):
    raise ValueError(f"{attribute.name} = {value!r}: allowed is {allowed}")


def in_range(low: float, high: float = math.inf, *, open_low: bool = False, open_high: bool = False):
    """Validate a number, or each component of a triple: finite unless `high` is infinite and closed."""
    left, right = "(["[not open_low], ")]"[not open_high]
    allowed = f"a number in {left}{low:g}, {high:g}{right}"

    def within(x: Any) -> Any:  # NaN is not
        above = x > low if open_low else x >= low
        below = x < high if open_high else x <= high
        return above & below

    def validate(_instance: Any, attribute: attrs.Attribute, value: Any) -> None:
        if isinstance(value, Texture):
            # Its extremes first: they are known.
            if not all(map(within, (*value.low, *value.high))):
                raise ValueError(f"{attribute.name}: {value.beyond(within)}: allowed is {allowed}")
            return
        for x in value if isinstance(value, tuple) else (value,):
            if not within(x):
                _refuse(attribute, value, allowed)

    return validate


positive = in_range(0.0, open_low=True, open_high=True)
non_negative = in_range(0.0, open_high=True)
unit_interval = in_range(0.0, 1.0)
finite = in_range(-math.inf, open_low=True, open_high=True)
_count = in_range(1, 2**31 - 1)


def _plain(kind: type, value: Any, field: Any) -> Any:
    """A number, whatever made it, as Python's own: what goes on to the kernels has one type."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, bool | np.bool_) or not isinstance(value, numbers.Real):
        _refuse(field, value, "a number")
    number = float(value)
    if kind is float or not math.isfinite(number):
        return number  # whether it is in range the validator says
    if int(number) != value:
        _refuse(field, value, "an integer")
    return int(number)


def _converter(convert: Callable[[Any, Any], Any]) -> Callable[[Any], Any]:
    """A converter that knows its field; attrs calls it with both, type checkers believe in one argument."""
    return cast(Any, attrs.Converter(convert, takes_field=True))


def _several(kind: type, count: int) -> Callable[[Any], Any]:
    """Converter of `count` numbers in a tuple, list or array."""

    def convert(values: Any, field: Any) -> tuple[Any, ...]:
        if not isinstance(values, tuple | list | np.ndarray) or np.ndim(values) != 1 or len(values) != count:
            _refuse(field, values, f"{count} numbers")
        return tuple(_plain(kind, value, field) for value in values)

    return _converter(convert)


def _unlike_zero(_instance: Any, attribute: attrs.Attribute, value: Any) -> None:
    """Validate a vector that has a direction."""
    finite(_instance, attribute, value)
    if not _has_length(value):
        _refuse(attribute, value, "a vector other than 0 whose length has a square that is a float64")


def _has_length(vector: Any) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(0.0 < np.linalg.norm(vector) < math.inf)


def _unit(vector: Any) -> Vector:
    x, y, z = (np.asarray(vector, np.float64) / np.linalg.norm(vector)).tolist()
    return x, y, z


_number = _converter(lambda value, field: _plain(float, value, field))
_integer = _converter(lambda value, field: _plain(int, value, field))
_triple = _several(float, 3)


def _truth(value: Any, field: Any) -> bool:
    if not isinstance(value, bool | np.bool_):
        _refuse(field, value, "True or False")
    return bool(value)


def _or_texture(plain: Any, channels: int) -> Callable[[Any], Any]:
    """A converter that leaves an image of so many channels as it is."""

    def convert(value: Any, field: Any) -> Any:
        if not isinstance(value, Texture):
            return plain.converter(value, field)
        if value.channels != channels:
            _refuse(field, value, f"a texture of {channels} channel{'s' if channels > 1 else ''}")
        return value

    return _converter(convert)


def largest(value: Any) -> Any:
    """Of a number or a colour, which it is itself, or of an image channel by channel."""
    if not isinstance(value, Texture):
        return value
    return value.high if value.channels > 1 else value.high[0]


def least(value: Any) -> Any:
    """As `largest`, at the other end."""
    if not isinstance(value, Texture):
        return value
    return value.low if value.channels > 1 else value.low[0]


Fresnel = Literal["auto", "schlick", "dielectric"]


def _fresnel(_instance: Any, attribute: attrs.Attribute, value: Any) -> None:
    if value not in get_args(Fresnel):
        _refuse(attribute, value, "'auto', 'schlick' or 'dielectric'")


@attrs.frozen
class Material:
    """Diffuse `color (1 - gloss) (1 - transparency)` under a Cook-Torrance lobe of weight `gloss`.

    Of the diffuse light `translucency` crosses the surface and the rest stays on the side that it came from:
    `color (1 - gloss) (1 - t) ((1 - s) E(n) + s E(-n)) / pi`, n on the viewer's side.

    What the microfacets of a transparent surface do not reflect goes through, refracted (Walter et al., EGSR 2007),
    with the weight `transparency tint`; they reflect with the weight `gloss`. Outside is where the normal points to.
    The weights make no energy: `g F + t (1 - F) + color (1 - g) (1 - t) <= 1` for all F.

    Attributes
    ----------
    color : reflectance in [0, 1] per channel.
    gloss : the paper's share g of reflected light, in [0, 1].
    roughness : Beckmann alpha, in [1e-4, 1.5].
    f0 : Schlick's reflectance at normal incidence, in [0, 1] per channel.
    translucency : share s of the diffuse light that leaves on the other side, in [0, 1].
    transparency : share t of the light that goes through, of what is not reflected, in [0, 1].
    ior : index of refraction, inside over outside, in [0.1, 10].
    tint : share of the light left at every passage through the surface, in [0, 1] per channel.
    fresnel : "schlick", F of `f0`, or "dielectric", F of `ior`: exact, unpolarised, total reflection included. "auto"
        is "dielectric" of what is transparent, which can be nothing else, and "schlick" of what is not. Both sides of
        an opaque surface are its outside.
    occludes : whether a transparent surface hides lights and ambient light, which refract in it, from shadow and
        occlusion rays. Else these go through it straight, with the weight `transparency tint` at every passage, as
        through thin glass; photons on their way from a light do too.

    Color, gloss and roughness may be a `Texture`, of 3 channels, 1 and 1, of an opaque surface.
    """

    color: Color | Texture = attrs.field(
        converter=_or_texture(_triple, 3), default=(0.8, 0.8, 0.8), validator=unit_interval
    )
    gloss: float | Texture = attrs.field(converter=_or_texture(_number, 1), default=0.0, validator=unit_interval)
    roughness: float | Texture = attrs.field(
        converter=_or_texture(_number, 1), default=0.5, validator=in_range(1e-4, 1.5)
    )
    f0: Color = attrs.field(converter=_triple, default=(0.04, 0.04, 0.04), validator=unit_interval)
    translucency: float = attrs.field(converter=_number, default=0.0, validator=unit_interval)
    transparency: float = attrs.field(converter=_number, default=0.0, validator=unit_interval)
    ior: float = attrs.field(converter=_number, default=1.5, validator=in_range(0.1, 10.0))
    tint: Color = attrs.field(converter=_triple, default=(1.0, 1.0, 1.0), validator=unit_interval)
    fresnel: Fresnel = attrs.field(default=cast(Fresnel, "auto"), validator=_fresnel)
    occludes: bool = attrs.field(converter=_converter(_truth), default=True)

    def __attrs_post_init__(self) -> None:
        """Refuse what a transparent surface cannot have, and an opaque one that casts no shadow."""
        if self.transparency == 0.0:
            if not self.occludes:
                raise ValueError("occludes = False: allowed is True with transparency = 0.0")
            return
        if self.fresnel == "schlick":
            raise ValueError(f"fresnel = 'schlick': allowed is 'dielectric' with transparency = {self.transparency!r}")
        for name in self.textures:
            raise ValueError(f"{name}: is an image: allowed is none with transparency = {self.transparency!r}")

    @property
    def dielectric(self) -> bool:
        """Whether its microfacets reflect as those of a dielectric do."""
        return self.transparency > 0.0 if self.fresnel == "auto" else self.fresnel == "dielectric"

    @property
    def textures(self) -> dict[str, Texture]:
        """The fields that are images, by name."""
        values = ((field.name, getattr(self, field.name)) for field in attrs.fields(type(self)))
        return {name: value for name, value in values if isinstance(value, Texture)}


BLACK_SURFACE = Material(color=BLACK, gloss=0.0)


@attrs.frozen(eq=False, repr=False)
class Mesh:
    """Triangles, rounded to float32 once so that both sides see the same geometry.

    Attributes
    ----------
    vertices : (V, 3) float64 array, each value representable in float32.
    faces : (F, 3) int64 array of vertex indices; the normal is (v1 - v0) x (v2 - v0).
    normals : (V, 3) float64 array of unit shading normals, or None for flat shading.
    uv : (F, 3, 2) float64 array, each value representable in float32: where in an image the corners of the faces lie,
        see `scenes.textures`; or None. Faces that share a vertex may have it in two places.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    uv: np.ndarray | None = None

    @classmethod
    def from_arrays(cls, vertices: Any, faces: Any, *, smooth: bool = False, uv: Any = None) -> "Mesh":
        """Check shapes, indices and finiteness; area-weighted normals where faces meet in a place if `smooth`.

        `uv` is (F, 3, 2), or (V, 2) of the vertices.
        """
        with np.errstate(over="ignore"):  # refused below
            vertices = np.ascontiguousarray(np.asarray(vertices, np.float32), np.float64)
        faces = np.ascontiguousarray(faces, np.int64)
        if vertices.ndim != 2 or vertices.shape[1:] != (3,) or faces.ndim != 2 or faces.shape[1:] != (3,):
            raise ValueError(
                f"mesh has vertices {vertices.shape} and faces {faces.shape}: allowed is (V, 3) and (F, 3)"
            )
        if len(faces) == 0:
            raise ValueError("mesh has no faces: allowed is at least one triangle")
        if not np.isfinite(vertices).all():
            bad = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
            raise ValueError(f"vertices[{bad}] = {tuple(vertices[bad].tolist())}: allowed are finite numbers")
        outside = (faces < 0) | (faces >= len(vertices))
        if outside.any():
            bad = int(np.flatnonzero(outside.any(axis=1))[0])
            raise ValueError(
                f"faces[{bad}] = {tuple(faces[bad].tolist())}: allowed are indices in [0, {len(vertices) - 1}]"
            )
        corners = vertices[faces]
        if not np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).any():
            raise ValueError("mesh has no area: allowed is at least one triangle that has")
        normals = _vertex_normals(vertices, faces) if smooth else None
        return cls(vertices, faces, normals, None if uv is None else _of_corners(uv, len(vertices), faces))

    def __repr__(self) -> str:
        """Its size, in one line."""
        shading = "flat" if self.normals is None else "smooth"
        return f"Mesh({len(self.vertices)} vertices, {len(self.faces)} faces, {shading})"

    def centroid(self) -> Vector:
        """Centre of mass of the surface."""
        corners = self.vertices[self.faces]
        area = np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1, keepdims=True
        )
        x, y, z = (np.sum(area * corners.mean(axis=1), axis=0) / area.sum()).tolist()
        return x, y, z


def _of_corners(uv: Any, vertices: int, faces: np.ndarray) -> np.ndarray:
    """Places in an image as `Mesh.uv` has them."""
    with np.errstate(over="ignore"):  # refused below
        places = np.ascontiguousarray(np.asarray(uv, np.float32), np.float64)
    if places.shape not in ((vertices, 2), (*faces.shape, 2)):
        raise ValueError(f"uv {places.shape}: allowed is {(*faces.shape, 2)} of corners or {(vertices, 2)} of vertices")
    places = places[faces] if places.ndim == 2 else places
    if not np.isfinite(places).all():
        face, corner, _ = np.argwhere(~np.isfinite(places))[0]
        raise ValueError(f"uv of corner {corner} of face {face}: {places[face, corner].tolist()}: allowed are finite")
    return places


def _vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted normals of the faces that meet in a place: files split vertices where a texture has a seam."""
    _, places = np.unique(vertices + 0.0, axis=0, return_inverse=True)  # -0.0 is 0.0
    corners = vertices[faces]
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    weighted[coincident.repeated(faces)] = 0.0  # in the other winding it would take its normal away again
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, places[faces[:, corner]], weighted)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.divide(normals, length, out=np.tile([0.0, 0.0, 1.0], (len(normals), 1)), where=length > 0)
    return unit.astype(np.float32).astype(np.float64)[places]


@attrs.frozen(eq=False)
class Object:
    """A named mesh with a material; an object that emits is an area light and its surface is black.

    `emission` is the radiance leaving the side that the face normals point to; the surface of an
    emitter neither reflects nor transmits, on both sides, for every term. It may be a `Texture` of 3 channels; an
    object of images needs a mesh with uv.
    """

    name: str
    mesh: Mesh
    material: Material = Material()
    emission: Color | Texture = attrs.field(converter=_or_texture(_triple, 3), default=BLACK, validator=non_negative)

    def __attrs_post_init__(self) -> None:
        """Refuse a transparent lamp, and an image that nothing says how to lay on the surface."""
        if self.emits and self.material.transparency > 0.0:
            raise ValueError(
                f"{self.name!r}: transparency = {self.material.transparency!r}: allowed is 0 with emission = "
                f"{self.emission!r}: the surface of a lamp is black"
            )
        for name in self.images:
            if self.mesh.uv is None:
                raise ValueError(
                    f"{self.name!r}: {name}: is an image, and nothing says how it lies on the mesh: allowed are a "
                    "rectangle, and meshes with uv (OBJ: vt; GLB: TEXCOORD_0; PLY: u, v or s, t or texcoord)"
                )
            if self.mesh.uv.shape != (*self.mesh.faces.shape, 2):
                raise ValueError(f"{self.name!r}: uv {self.mesh.uv.shape}: allowed is {(*self.mesh.faces.shape, 2)}")

    @property
    def emits(self) -> bool:
        """Whether the object is an area light."""
        return any(largest(self.emission))

    @property
    def surface(self) -> Material:
        """The material that light meets: black where the object emits."""
        return BLACK_SURFACE if self.emits else self.material

    @property
    def images(self) -> dict[str, Texture]:
        """The fields that are images, by name, but those of a material that no light meets."""
        emitted = {"emission": self.emission} if isinstance(self.emission, Texture) else {}
        return {**self.surface.textures, **emitted}

    def radiances(self) -> np.ndarray:
        """About the mean radiance of the front of each face, (F, 3): what light is sampled by.

        Of an image the mean of 64 points of the face, and of all texels: so it is above 0 where any texel is.
        """
        faces = len(self.mesh.faces)
        if not isinstance(self.emission, Texture):
            return np.tile(self.emission, (faces, 1))
        assert self.mesh.uv is not None
        here = np.zeros((faces, 3))
        for weights in _MIDDLES:
            here += self.emission.near(np.einsum("k,fkc->fc", weights, self.mesh.uv))
        return 0.5 * (here / len(_MIDDLES) + self.emission.texels.mean(axis=0, dtype=np.float64).mean(axis=0))

    def mean_radiance(self) -> Color:
        """Mean of `radiances` over the area."""
        if not isinstance(self.emission, Texture):
            return self.emission
        corners = self.mesh.vertices[self.mesh.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        red, green, blue = (area @ self.radiances() / area.sum()).tolist()
        return red, green, blue


def _middles(side: int) -> np.ndarray:
    """Weights of the corners (side², 3) in the middles of the equal parts that a triangle is cut into."""
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(side) for j in range(side - i)]
    turned = [(i + 2 / 3, j + 2 / 3) for i in range(side - 1) for j in range(side - 1 - i)]
    b1, b2 = np.array(upright + turned).T / side
    return np.column_stack([1.0 - b1 - b2, b1, b2])


_MIDDLES = _middles(8)


@attrs.frozen
class PointLight:
    """A point that radiates `intensity` (radiance x area) in every direction."""

    kind: ClassVar[str] = "point"
    sends: ClassVar[str] = "intensity"

    position: Vector = attrs.field(converter=_triple, validator=finite)
    intensity: Color = attrs.field(converter=_triple, validator=non_negative)

    @property
    def centre(self) -> Vector | None:
        """Where it is."""
        return self.position


@attrs.frozen
class SpotLight:
    """A point that radiates `intensity` towards `target`, less aside, and nothing beyond the angle `cutoff`.

    In a direction at the angle t from the axis it is `intensity` up to `beam`, and from there falls linearly in t:
    `intensity (cutoff - t) / (cutoff - beam)`. Both angles are degrees from the axis; without a `beam` it is three
    quarters of `cutoff`.
    """

    kind: ClassVar[str] = "spot"
    sends: ClassVar[str] = "intensity"

    position: Vector = attrs.field(converter=_triple, validator=finite)
    target: Vector = attrs.field(converter=_triple, validator=finite)
    intensity: Color = attrs.field(converter=_triple, validator=non_negative)
    cutoff: float = attrs.field(converter=_number, default=20.0, validator=in_range(0.01, 90.0))
    beam: float | None = attrs.field(converter=attrs.converters.optional(_number), default=None)

    def __attrs_post_init__(self) -> None:
        """Refuse a light without a direction, and a beam that is wider than the light."""
        if not _has_length(np.subtract(self.target, self.position)):
            raise ValueError(
                f"target = {self.target!r}: allowed is a point other than position whose distance from it has a "
                "square that is a float64"
            )
        if self.beam is not None and not 0.0 <= self.beam <= self.cutoff:
            raise ValueError(f"beam = {self.beam!r}: allowed is a number in [0, cutoff], cutoff = {self.cutoff!r}")

    @property
    def axis(self) -> Vector:
        """Unit vector towards the target."""
        return _unit(np.subtract(self.target, self.position))

    @property
    def angles(self) -> tuple[float, float]:
        """Beam and cutoff, radians."""
        beam = 0.75 * self.cutoff if self.beam is None else self.beam
        return math.radians(beam), math.radians(self.cutoff)

    @property
    def centre(self) -> Vector | None:
        """Where it is."""
        return self.position


@attrs.frozen
class DirectionalLight:
    """Light from far away that flies along `direction`: `irradiance` on a surface that faces it."""

    kind: ClassVar[str] = "directional"
    sends: ClassVar[str] = "irradiance"

    direction: Vector = attrs.field(converter=_triple, validator=_unlike_zero)
    irradiance: Color = attrs.field(converter=_triple, validator=non_negative)

    @property
    def way(self) -> Vector:
        """Unit vector along which the light flies."""
        return _unit(self.direction)

    @property
    def centre(self) -> Vector | None:
        """None: it is nowhere."""
        return None


@attrs.frozen
class SunLight:
    """A disc in the sky, as far away as the stars, of the apparent diameter `angle` (degrees) and one radiance.

    Light from its middle flies along `direction`. A surface that faces the middle, and sees all of the disc, has
    `irradiance = radiance pi sin²(angle / 2)`. The sky behind it is seen as if there were no sun.
    """

    kind: ClassVar[str] = "sun"
    sends: ClassVar[str] = "irradiance"

    direction: Vector = attrs.field(converter=_triple, validator=_unlike_zero)
    irradiance: Color = attrs.field(converter=_triple, validator=non_negative)
    angle: float = attrs.field(converter=_number, default=0.533, validator=in_range(1e-3, 180.0))

    @property
    def way(self) -> Vector:
        """Unit vector along which the light of its middle flies."""
        return _unit(self.direction)

    @property
    def half_angle(self) -> float:
        """From the middle of the disc to its edge, radians."""
        return math.radians(self.angle) / 2.0

    @property
    def radiance(self) -> Color:
        """Of every point of the disc."""
        red, green, blue = (each / (math.pi * math.sin(self.half_angle) ** 2) for each in self.irradiance)
        return red, green, blue

    @property
    def centre(self) -> Vector | None:
        """None: it is nowhere."""
        return None


@attrs.frozen
class SphereLight:
    """A sphere whose outside has the same `radiance` everywhere; like that of every emitter its surface is black."""

    kind: ClassVar[str] = "sphere"
    sends: ClassVar[str] = "radiance"

    center: Vector = attrs.field(converter=_triple, validator=finite)
    radius: float = attrs.field(converter=_number, validator=positive)
    radiance: Color = attrs.field(converter=_triple, validator=non_negative)

    @property
    def centre(self) -> Vector | None:
        """Where it is."""
        return self.center


Light = PointLight | SpotLight | DirectionalLight | SunLight | SphereLight
"""What stands in `Scene.lights`. Each kind has its `kind`, the name of the field that it `sends`, and its `centre`."""

LIGHTS: dict[str, type] = {each.kind: each for each in (PointLight, SpotLight, DirectionalLight, SunLight, SphereLight)}


def shines(light: Light) -> bool:
    """Whether a light sends anything."""
    return any(getattr(light, light.sends))


@attrs.frozen(eq=False)
class Sky:
    """What a ray sees that misses everything: a constant colour, or the paper's textured sphere.

    With a texture the ray is intersected with the sphere (`center`, `radius`), the farther hit counting,
    and, n being the unit vector from the centre to that point, the texture is looked up at
    `u = atan2(n.x, n.y) / (2 pi) + 0.5`, `v = 0.5 - n.z / 2` (paper), bilinearly between texel centres
    at (i + 0.5) / size, u repeating and v clamped. A ray that misses the sphere is black.

    Attributes
    ----------
    color : radiance of a constant sky; ignored with a texture.
    texture : (H, W, 3) float32 array, or None.
    center, radius : of the sphere. With an infinite radius n is the direction of the ray: no parallax.
    projection : "equal-area" is the paper's v; "lat-long", `v = acos(n.z) / pi`, is that of usual panoramas.
    """

    color: Color = attrs.field(converter=_triple, default=BLACK, validator=non_negative)
    texture: np.ndarray | None = attrs.field(
        default=None, repr=lambda texels: "None" if texels is None else f"<{texels.shape[1]} x {texels.shape[0]}>"
    )
    center: Vector = attrs.field(converter=_triple, default=(0.0, 0.0, 0.0), validator=finite)
    radius: float = attrs.field(converter=_number, default=100.0, validator=in_range(0.0, open_low=True))
    projection: Literal["equal-area", "lat-long"] = "equal-area"

    @property
    def is_black(self) -> bool:
        """Whether the sky contributes nothing."""
        return not (any(self.color) if self.texture is None else self.texture.any())

    @property
    def one_color(self) -> Color | None:
        """What is seen everywhere; None of a texture that is not black."""
        return BLACK if self.is_black else self.color if self.texture is None else None


@attrs.frozen
class Ambient:
    """The ambient light, and the distance beyond which nothing occludes it (`range`).

    It is L_a0 = `color` from everywhere, or, with the `source` "sky", what the sky sends from each direction:
    `(1 / pi) ∫ hit L_sky cos` in the place of `AO L_a0`.
    """

    color: Color = attrs.field(converter=_triple, default=BLACK, validator=non_negative)
    range: float = attrs.field(converter=_number, default=math.inf, validator=in_range(0.0, open_low=True))
    source: Literal["constant", "sky"] = "constant"

    def __attrs_post_init__(self) -> None:
        """Refuse a colour that nothing would read."""
        if self.source == "sky" and any(self.color):
            raise ValueError(f"color = {self.color!r}: allowed is none with source = 'sky'")


@attrs.frozen
class Camera:
    """The paper's near-plane camera; `pixel` says where in a pixel the ray goes through.

    `corner` is the paper's top-left corner, `centre` the middle, `jitter` a random point (default).
    """

    position: Vector = attrs.field(converter=_triple, validator=finite)
    target: Vector = attrs.field(converter=_triple, validator=finite)
    up: Vector = attrs.field(converter=_triple, default=(0.0, 0.0, 1.0), validator=finite)
    fov: float = attrs.field(
        converter=_number, default=45.0, validator=in_range(0.0, 180.0, open_low=True, open_high=True)
    )
    near: float = attrs.field(converter=_number, default=0.1, validator=positive)
    pixel: Literal["corner", "centre", "jitter"] = "jitter"

    def __attrs_post_init__(self) -> None:
        """Refuse a camera that has no direction."""
        forward = np.subtract(self.target, self.position)
        if not forward.any():
            raise ValueError(f"target = {self.target!r}: allowed is a point other than position")
        with np.errstate(over="ignore", invalid="ignore"):
            apart, across = np.linalg.norm(forward), np.linalg.norm(np.cross(forward, self.up))
        if not (0.0 < apart < math.inf and across < math.inf):
            raise ValueError(
                f"position = {self.position!r}, target = {self.target!r}, up = {self.up!r}: allowed are points whose "
                "distance, and its product with up, have a square that is a float64"
            )
        if not across > 0:
            raise ValueError(f"up = {self.up!r}: allowed is a vector not parallel to target - position")

    def frame(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Unit vectors to the right, up and forward, each (3,) float64."""
        forward = np.subtract(self.target, self.position).astype(np.float64)
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, np.asarray(self.up, np.float64))
        right /= np.linalg.norm(right)
        return right, np.cross(right, forward), forward

    def rays(self, film: np.ndarray, *, aspect: float) -> np.ndarray:
        """Unit directions through points of the near plane (paper).

        Parameters
        ----------
        film : (..., 2) array, positions in [0, 1]²: (0, 0) is the top-left corner, x to the right, y down.
        aspect : width over height.

        Returns
        -------
        (..., 3) float64 unit vectors; the origin of every ray is `position`.
        """
        right, up, forward = self.frame()
        width = 2.0 * self.near * math.tan(math.radians(self.fov) / 2.0)
        height = width / aspect
        x = (np.asarray(film)[..., 0] - 0.5) * width
        y = (0.5 - np.asarray(film)[..., 1]) * height
        directions = x[..., None] * right + y[..., None] * up + self.near * forward
        return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


@attrs.frozen
class Photons:
    """Photon maps.

    Attributes
    ----------
    count : photons emitted per pass, in all directions; those that cannot meet the scene need not be traced.
    radius : kernel radius of the first pass.
    nearest : k of the paper's search.
    kernel : the kernel of a radius; all three are named in `scenes.limits.Kernel`.
    survival : probability that a photon survives the roulette at any surface that is not black, of which at most 0.99
        is used, or the scene's largest albedo above that; None: the largest channel of what it would carry on. Any
        value has the same mean, but below the square of an albedo the variance may be infinite.
    scattering : on what the photons of the direct term scatter: "diffuse", the diffuse part alone, or "full", the
        specular lobe too, so that the term holds the light that glossy surfaces throw (caustics). The chain of the
        specular term keeps "diffuse", which its integral means.
    """

    count: int = attrs.field(converter=_integer, default=50_000, validator=_count)
    radius: float = attrs.field(converter=_number, default=0.05, validator=positive)
    nearest: int = attrs.field(converter=_integer, default=50, validator=in_range(2, 2**31 - 1))
    kernel: Literal["simpson", "epanechnikov", "uniform"] = "simpson"
    survival: float | None = attrs.field(
        converter=attrs.converters.optional(_number),
        default=None,
        validator=attrs.validators.optional(in_range(0.0, 1.0, open_low=True)),
    )
    scattering: Literal["diffuse", "full"] = "diffuse"


@attrs.frozen
class Toggles:
    """The paper's switches.

    ambient_occlusion off: the ambient light is L_a0 everywhere. lighting off: no direct term. reflections off: no
    specular term, and the diffuse weight is without (1 - gloss), as the paper's code has it; what is transparent stays
    so.
    """

    ambient_occlusion: bool = True
    lighting: bool = True
    reflections: bool = True


_OPAQUE_RULES = (
    ("normals", "face", "for which no side is the viewer's"),
    ("ignore", "object", "whose rays never leave what they have entered"),
    ("shadows", "paper", "by which what is inside of a surface sees no light"),
)
"""Choices of a scene that a transparent surface has none of: field, value, and why."""


@attrs.frozen(eq=False, repr=False)
class Scene:
    """Everything that is rendered. Immutable; `attrs.evolve` makes variations.

    `rings` is N of the paper's rule `mu_k = k / (N + 1)` over the hemisphere (its max_samples).

    Choices that the paper's code makes or leaves open; the first of each is the default:

    - `shadows` is "physical", where visibility alone decides, or "paper", its early return on top: a point that sees
      the centre of no light (a point light's or spot's position, a sphere's center, an emitting object's centroid by
      area, its own faces apart) has `color` times the ambient light and nothing else, and a specular chain ends there.
      Without lights there is none, and lights that have no centre are refused.
    - `irradiance`: direct light is read from E as "E / pi", or as "E", pi times too bright.
    - `ignore`: a ray that leaves a surface passes the "face" that it leaves, or all of its "object", which costs
      concave objects their own shadows and occlusion.
    - `normals`: a surface is shaded about the normal of the "viewer"'s side, or about the one that its "face" has,
      whichever side is seen: from behind, ambient and direct are those of the front, and the specular lobe is 0 (its
      masking is, where the view is below the surface). Photons, smooth meshes, translucency and transparency need the
      former.
    - `intersection`: "watertight", or "paper": a test of angles with absolute epsilons of 1e-5 against every face.

    `substitutions` says of a scene that was read from another renderer's file what stands for what the model cannot
    say, and what was assumed: no image depends on it.
    """

    name: str
    camera: Camera
    objects: tuple[Object, ...] = ()
    lights: tuple[Light, ...] = ()
    ambient: Ambient = Ambient()
    sky: Sky = attrs.field(factory=Sky)
    photons: Photons = Photons()
    toggles: Toggles = Toggles()
    resolution: tuple[int, int] = attrs.field(
        converter=_several(int, 2), default=(128, 128), validator=in_range(1, 65536)
    )
    exposure: float = attrs.field(converter=_number, default=1.0, validator=positive)
    max_bounces: int = attrs.field(converter=_integer, default=2, validator=in_range(0, 64))
    rings: int = attrs.field(converter=_integer, default=16, validator=in_range(1, 65536))
    scope: Scope = "all"
    shadows: Literal["physical", "paper"] = "physical"
    irradiance: Literal["E / pi", "E"] = "E / pi"
    ignore: Literal["face", "object"] = "face"
    normals: Literal["viewer", "face"] = "viewer"
    intersection: Literal["watertight", "paper"] = "watertight"
    draw_lights: bool = False
    substitutions: tuple[str, ...] = ()

    def __attrs_post_init__(self) -> None:
        """Refuse two objects of one name, for verdicts are reported by object; and faces that are one in two looks."""
        names = [thing.name for thing in self.objects]
        for name in names:
            if name in ("", "image"):  # the name of the whole picture, as a region
                raise ValueError(f"objects: name = {name!r}: allowed is any other than '' and 'image'")
            if names.count(name) > 1:
                raise ValueError(f"objects: name {name!r} is used twice: allowed are distinct names")

        if self.normals == "face":
            for thing in self.objects:
                if thing.mesh.normals is not None:
                    raise ValueError(
                        f"objects: {thing.name!r}: normals = 'smooth': allowed is 'flat' where the scene has normals = "
                        "'face'"
                    )
                if thing.material.translucency > 0.0:
                    raise ValueError(
                        f"objects: {thing.name!r}: translucency = {thing.material.translucency!r}: allowed is 0 where "
                        "the scene has normals = 'face', for which no side is the viewer's"
                    )
        for name, rule, why in _OPAQUE_RULES:
            if getattr(self, name) == rule and self.transparent:
                thing = self.transparent[0]
                raise ValueError(
                    f"objects: {thing.name!r}: transparency = {thing.material.transparency!r}: allowed is 0 where the "
                    f"scene has {name} = {rule!r}, {why}"
                )
        if self.photons.scattering == "full" and self.unshadowing:
            raise ValueError(
                f"objects: {self.unshadowing[0].name!r}: occludes = False: allowed is True where the scene has "
                "photons.scattering = 'full', by which the same light arrives refracted"
            )
        if self.shadows == "paper":
            for number, light in enumerate(self.lights):
                if light.centre is None:
                    having = ", ".join(
                        kind for kind, each in LIGHTS.items() if "direction" not in attrs.fields_dict(each)
                    )
                    raise ValueError(
                        f"lights[{number}]: kind = {light.kind!r}: allowed with shadows = 'paper', which asks for the "
                        f"centre of a light, are {having}"
                    )
        for number, light in enumerate(self.lights):
            if isinstance(light, SphereLight) and math.dist(light.center, self.camera.position) <= light.radius:
                raise ValueError(
                    f"lights[{number}]: center = {light.center!r}, radius = {light.radius!r}: allowed is a sphere that "
                    f"the camera at {self.camera.position!r} is outside of"
                )
        coincident.check_camera(self.objects, self.camera.position)
        # Frozen but for this: what lies over an equal face is no part of what is rendered.
        object.__setattr__(self, "objects", coincident.counted_once(self.objects, self.camera.position))

    def __repr__(self) -> str:
        """Its name and size, in one line."""
        faces = sum(len(thing.mesh.faces) for thing in self.objects)
        lamps = sum(thing.emits for thing in self.objects)
        width, height = self.resolution
        return (
            f"Scene({self.name!r}, {len(self.objects)} objects of {faces} faces, {lamps} of them lamps, "
            f"{len(self.lights)} other lights, {width} x {height})"
        )

    @property
    def aspect(self) -> float:
        """Width over height."""
        return self.resolution[0] / self.resolution[1]

    def diffuse_weight(self, material: Material) -> Color:
        """`color (1 - gloss) (1 - transparency)`; without the gloss where reflections are off (paper's code).

        Of an image the largest that any texel has: `renderer.material` and `reference.translate` look it up.
        """
        share = 1.0 - least(material.gloss) if self.toggles.reflections else 1.0
        share *= 1.0 - material.transparency
        red, green, blue = largest(material.color)
        return red * share, green * share, blue * share

    def specular_weight(self, material: Material) -> float:
        """Gloss, of an image the largest; 0 where reflections are off."""
        return largest(material.gloss) if self.toggles.reflections else 0.0

    def transmission_weight(self, material: Material) -> Color:
        """`transparency tint`, whether reflections are on or off."""
        red, green, blue = material.tint
        return red * material.transparency, green * material.transparency, blue * material.transparency

    @property
    def transparent(self) -> tuple[Object, ...]:
        """The objects that light is refracted into, whether their tint leaves any of it or not."""
        return tuple(thing for thing in self.objects if thing.surface.transparency > 0.0)

    @property
    def unshadowing(self) -> tuple[Object, ...]:
        """The objects that shadow and occlusion rays go through."""
        return tuple(thing for thing in self.objects if not thing.surface.occludes)

    def passing_weight(self, material: Material) -> Color:
        """What is left of light beyond the surface on a shadow or occlusion ray: black behind what occludes."""
        return BLACK if material.occludes else self.transmission_weight(material)

    @property
    def translucent(self) -> tuple[Object, ...]:
        """The objects that let light through."""
        through = (thing for thing in self.objects if thing.surface.translucency > 0.0)
        return tuple(thing for thing in through if any(largest(thing.surface.color)))

    @property
    def has_lights(self) -> bool:
        """Whether anything emits light and lighting is on."""
        return self.toggles.lighting and (any(map(shines, self.lights)) or any(thing.emits for thing in self.objects))

    @property
    def ambient_light(self) -> Color | None:
        """L_a0, that of a sky of one colour too; None where the ambient light is a textured sky."""
        return self.ambient.color if self.ambient.source == "constant" else self.sky.one_color

    @property
    def has_ambient(self) -> bool:
        """Whether the ambient light is other than black."""
        return self.ambient_light is None or any(self.ambient_light)

    @property
    def spheres(self) -> tuple[SphereLight, ...]:
        """The lights that have a surface of their own, a black one, whether they shine or not."""
        return tuple(each for each in self.lights if isinstance(each, SphereLight))

    @property
    def surfaces(self) -> tuple[Material, ...]:
        """What is shaded of each object, and behind them of each sphere."""
        return (*(thing.surface for thing in self.objects), *(BLACK_SURFACE for _ in self.spheres))

    @property
    def shows_lights(self) -> bool:
        """Whether the background term shows lights: they are drawn, and on."""
        return self.draw_lights and self.toggles.lighting

    @property
    def drawn_suns(self) -> tuple[SunLight, ...]:
        """The suns that the background term shows."""
        drawn = self.shows_lights
        return tuple(each for each in self.lights if drawn and isinstance(each, SunLight) and shines(each))

    @property
    def light_centres(self) -> list[tuple[Vector, int]]:
        """Centre of each light that is on and has one, and the index of its object (-1: none).

        The spheres are counted on behind the objects.
        """
        if not self.toggles.lighting:
            return []
        points, sphere = [], len(self.objects)
        for light in self.lights:
            if shines(light) and light.centre is not None:
                points.append((light.centre, sphere if isinstance(light, SphereLight) else -1))
            sphere += isinstance(light, SphereLight)
        return points + [(thing.mesh.centroid(), i) for i, thing in enumerate(self.objects) if thing.emits]

    @property
    def irradiance_factor(self) -> float:
        """What direct light is multiplied by: pi where E is taken for radiance."""
        return math.pi if self.irradiance == "E" else 1.0

    @property
    def occlusion_range(self) -> float:
        """Distance within which geometry hides the ambient light; 0 where ambient occlusion is off."""
        return self.ambient.range if self.toggles.ambient_occlusion else 0.0

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the box around all surfaces, (3,) float64 each; zeros for an empty scene."""
        lows, highs = self.boxes()
        if not len(lows):
            return np.zeros(3), np.zeros(3)
        return lows.min(axis=0), highs.max(axis=0)

    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the boxes around each object, and behind them each sphere, (O + S, 3) float64 each."""
        lows = [thing.mesh.vertices.min(axis=0) for thing in self.objects]
        highs = [thing.mesh.vertices.max(axis=0) for thing in self.objects]
        lows += [np.subtract(sphere.center, sphere.radius) for sphere in self.spheres]
        highs += [np.add(sphere.center, sphere.radius) for sphere in self.spheres]
        return np.reshape(lows, (-1, 3)), np.reshape(highs, (-1, 3))

    def digest(self, *, without: tuple[str, ...] = ("name", "exposure", "substitutions")) -> str:
        """sha256 of the content, fields named in `without` left out: equal scenes share cached results."""
        state = hashlib.sha256()
        for field in attrs.fields(Scene):
            if field.name not in without:
                absorb(state, field.name)
                absorb(state, getattr(self, field.name))
        return state.hexdigest()


def absorb(state: Any, value: Any) -> None:
    """Feed a value of the model into a hash, with its type and shape, so that no two values run together."""
    if attrs.has(type(value)):
        state.update(type(value).__name__.encode())
        for field in attrs.fields(type(value)):
            if field.eq:  # what others say already is left out
                absorb(state, getattr(value, field.name))
    elif isinstance(value, np.ndarray):
        state.update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, tuple):
        state.update(f"({len(value)}".encode())
        for item in value:
            absorb(state, item)
    else:
        state.update(f"{type(value).__name__}:{value!r};".encode())
