"""The terms of `L_o = L_ambient + L_direct + L_specular + L_transmission (+ L_background)`, and the estimate of one.

`total = (((ambient + direct) + specular) + transmission) + background`, added in the order of the rows, bit for bit. A
new term is a row here and a file a side, `renderer/terms/<name>.py` and `reference/terms/<name>.py`.
"""

import base64
import functools
import html
import io
import operator
from collections.abc import Callable, Collection

import attrs
import numpy as np
import PIL.Image

from termwise.scenes import reads, srgb
from termwise.scenes.model import BLACK, Color, Material, Scene, largest
from termwise.scenes.reads import Read, read

Term = str
"""The name of a row."""
TOTAL = "total"
WHITE: Color = (1.0, 1.0, 1.0)


@attrs.frozen
class TermRow:
    """What a term is, whoever estimates it.

    Attributes
    ----------
    name : of the term, and of its module on both sides.
    weight : scene, material -> a factor on all that a surface shows of the term, or a bound of it: where it is 0 the
        surface is black in the term.
    absent : scene -> why the term is 0 everywhere, or None.
    reads : the fields of a scene that its image depends on, see `scenes.reads`; beside them it has those of the terms
        that it meets.
    scoped : whether it means an irradiance, of the first hit or of all bounces.
    meets : terms of the light at the vertices after the camera's; none where it has no chain of such vertices.
    sky : whether a ray that misses everything brings it the sky's light.
    beyond : scene -> what a pixel has that sees no object; None where that differs from pixel to pixel.
    beyond_is : that in words.
    limit : fields of a `Limit` that its integral depends on, constant factors apart.
    seldom : whether few scenes have it: in the keys of the others is nothing of what it reads.
    """

    name: Term
    weight: Callable[[Scene, Material], Color]
    absent: Callable[[Scene], str | None]
    reads: tuple[Read, ...]
    scoped: bool = False
    meets: tuple[Term, ...] = ()
    sky: bool = False
    beyond: Callable[[Scene], Color | None] = lambda scene: BLACK
    beyond_is: str = "nothing that has the term"
    limit: tuple[str, ...] = ()
    seldom: bool = False

    def has(self, scene: Scene, surface: Material) -> bool:
        """Whether a surface may be other than black in the term."""
        return any(self.weight(scene, surface))


def first(*cases: tuple[bool, str]) -> str | None:
    """The reason of the first case that holds."""
    return next((reason for holds, reason in cases if holds), None)


def _without(scene: Scene, weight: Callable[[Scene, Material], Color]) -> bool:
    """Whether all surfaces are black in a term."""
    return not any(any(weight(scene, thing.surface)) for thing in scene.objects)


def _diffuse(scene: Scene, material: Material) -> Color:
    return scene.diffuse_weight(material)


def _diffuse_part(scene: Scene, material: Material) -> tuple[object, ...]:
    """All that the weight of a surface depends on."""
    weight = scene.diffuse_weight(material)
    return (weight, material.color, material.gloss) if {"color", "gloss"} & {*material.textures} else weight


def _ambient(scene: Scene, material: Material) -> Color:
    # In the paper's shadow ambient light is of the whole colour.
    return largest(material.color) if scene.shadows == "paper" else scene.diffuse_weight(material)


def _specular(scene: Scene, material: Material) -> Color:
    gloss = scene.specular_weight(material)
    return gloss, gloss, gloss


def _transmission(scene: Scene, material: Material) -> Color:
    return scene.transmission_weight(material)


def _dielectric(scene: Scene) -> bool:
    return any(thing.surface.dielectric for thing in scene.objects)


def _beyond(scene: Scene) -> Color | None:
    """What is seen beside all objects, where that is one colour."""
    return None if scene.drawn_suns else scene.sky.one_color


def _scatters_fully(scene: Scene) -> bool:
    return scene.photons.scattering == "full"


def _by_lights(scene: Scene) -> bool:
    return scene.shadows == "paper"


_NO_DIFFUSE = "no surface has color (1 - gloss) (1 - transparency) > 0"
_RULES = read("shadows", "ignore", "normals")
_EMITTERS = read("objects.emission", of=lambda scene: tuple(thing.emits for thing in scene.objects))
_DIFFUSE = read(
    "objects.material.color",
    "objects.material.gloss",
    "objects.material.translucency",
    "objects.material.transparency",
    "toggles.reflections",
    of=lambda scene: tuple(
        (_diffuse_part(scene, thing.surface), thing.surface.translucency) for thing in scene.objects
    ),
)
_MATERIAL = (
    "objects.material.color",
    "objects.material.gloss",
    "objects.material.roughness",
    "objects.material.f0",
    "toggles.reflections",
)
# Of all surfaces as soon as one has a dielectric's lobe: they share a kernel.
_DIELECTRIC = (
    "objects.material.fresnel",
    "objects.material.ior",
    "objects.material.tint",
    "objects.material.transparency",
)
# Of all transparent surfaces as soon as shadow rays go through one.
_PASSING = read(
    "objects.material.occludes",
    "objects.material.tint",
    "objects.material.transparency",
    when=lambda scene: bool(scene.unshadowing),
)
# Center and radius of a sphere are in every key, as meshes are: its black surface hides things from all terms.
_LIGHTS = (
    "lights.position",
    "lights.intensity",
    "lights.target",
    "lights.cutoff",
    "lights.beam",
    "lights.direction",
    "lights.irradiance",
    "lights.angle",
    "lights.radiance",
    "objects.emission",
    "toggles.lighting",
)
_SKY = read("sky.color", "sky.texture", "sky.center", "sky.radius", "sky.projection")

PHOTONS = (
    "photons.count",
    "photons.radius",
    "photons.nearest",
    "photons.kernel",
    "photons.survival",
    "photons.scattering",
)
"""Fields that only an estimate with photon maps depends on."""

TABLE: dict[Term, TermRow] = {
    row.name: row
    for row in (
        TermRow(
            "ambient",
            weight=_ambient,
            absent=lambda scene: first(
                (not scene.has_ambient, "the ambient light is black"), (_without(scene, _ambient), _NO_DIFFUSE)
            ),
            reads=(
                read("ambient.color", "ambient.range", "toggles.ambient_occlusion", "rings"),
                read("ambient.source", *_SKY.fields, when=lambda scene: scene.ambient.source == "sky"),
                _RULES,
                _EMITTERS,
                _DIFFUSE,
                read(*_LIGHTS, "objects.material.color", when=_by_lights),
                _PASSING,
            ),
            limit=("occluded", "rings", "shadows", "depth"),
        ),
        TermRow(
            "direct",
            weight=_diffuse,
            absent=lambda scene: first(
                (not scene.toggles.lighting, "lighting is off"),
                (not scene.has_lights, "the scene has no light"),
                (_without(scene, _diffuse), _NO_DIFFUSE),
            ),
            reads=(
                read(*_LIGHTS, *PHOTONS, "scope", "irradiance"),
                _RULES,
                _DIFFUSE,
                read(*_MATERIAL, when=_scatters_fully),
                read(*_DIELECTRIC, when=lambda scene: _scatters_fully(scene) and _dielectric(scene)),
                _PASSING,
            ),
            scoped=True,
            limit=("scope", "kernel", "shadows", "depth"),
        ),
        TermRow(
            "specular",
            weight=_specular,
            absent=lambda scene: first(
                (not scene.toggles.reflections, "reflections are off"),
                (_without(scene, _specular), "no surface has gloss > 0"),
                (scene.max_bounces == 0, "max_bounces is 0"),
            ),
            reads=(read(*_MATERIAL, "max_bounces"), read(*_DIELECTRIC, when=_dielectric), _SKY),
            scoped=True,
            # And transmission, where the scene has it: chains that begin with one of the two go on with both.
            meets=("ambient", "direct"),
            sky=True,
            limit=("occluded", "scope", "lobe", "diffuse", "cosine", "ambient", "rings", "kernel", "shadows", "depth"),
        ),
        TermRow(
            "transmission",
            weight=_transmission,
            absent=lambda scene: first(
                (not scene.transparent, "no surface has transparency > 0"),
                (_without(scene, _transmission), "every tint of a transparent surface is black"),
                (scene.max_bounces == 0, "max_bounces is 0"),
            ),
            reads=(read(*_MATERIAL, *_DIELECTRIC, "max_bounces"), _SKY),
            scoped=True,
            meets=("ambient", "direct", "specular"),
            sky=True,
            limit=("occluded", "scope", "ambient", "kernel", "depth"),
            seldom=True,
        ),
        TermRow(
            "background",
            weight=lambda scene, material: WHITE,  # all surfaces hide the sky
            absent=lambda scene: first(
                (
                    scene.sky.is_black and not (scene.draw_lights and scene.has_lights),
                    "the sky is black and lights are not drawn",
                )
            ),
            reads=(read("draw_lights"), _SKY, _EMITTERS, read(*_LIGHTS, when=lambda scene: scene.draw_lights)),
            sky=True,
            beyond=_beyond,
            beyond_is="the constant sky",
        ),
    )
}
TERMS: tuple[Term, ...] = tuple(TABLE)


def reads_of(term: Term) -> tuple[Read, ...]:
    """All that a term reads, in part through the terms that it meets."""
    met = (each for name in TABLE[term].meets if name != term for each in reads_of(name))
    return (*TABLE[term].reads, *met)


def named() -> frozenset[str]:
    """Fields that some term reads, or none at all; all others are in every key."""
    fields = (field for row in TABLE.values() for each in row.reads for field in each.fields)
    return frozenset((*fields, *reads.UNREAD))


def content(scene: Scene, term: Term, *, without: Collection[str] = ()) -> str:
    """sha256 of what a term's image depends on in a scene: where it is equal, so is every byte of the image.

    `without` names fields that an estimate of it does not read.
    """
    nothing = TABLE[term].seldom and TABLE[term].absent(scene) is not None
    here = [] if nothing else [each for each in reads_of(term) if each.when(scene)]
    whole = {field for each in here if each.of is None for field in each.fields}
    return reads.digest(scene, without=(named() - whole) | set(without), seen=here)


@attrs.frozen(eq=False)
class TermImage:
    """An estimate of a term's contribution to each pixel, its weight (color, gloss) inside.

    Attributes
    ----------
    mean : (H, W, 3) float64, radiance, linear Rec. 709, in the scene's radiance unit; mean over replicates.
    variance : (H, W, 3) float64, variance of `mean`, estimated from independent replicates; NaN with a single
        replicate, because low-discrepancy samples inside one replicate are not independent.
    samples : samples per pixel and replicate.
    replicates : independent replicates (own seed each, own photon maps) behind `mean`.
    seconds : wall-clock seconds, compilation excluded.
    images : (K, H, W, 3) floating, the replicates themselves, which `judge` takes; None where they were not kept.
    """

    mean: np.ndarray
    variance: np.ndarray
    samples: int
    replicates: int
    seconds: float
    images: np.ndarray | None = None

    @classmethod
    def from_replicates(cls, images: np.ndarray, *, samples: int, seconds: float, keep: bool = False) -> "TermImage":
        """Mean and variance of the mean of `images` (K, H, W, 3), accumulated in float64; `keep` the images too."""
        count = len(images)
        mean = np.asarray(np.mean(images, axis=0, dtype=np.float64))
        # Image by image: `np.var` would hold the distances of all of them at once, in float64.
        squares = np.zeros_like(mean)
        for image in images:
            squares += (image - mean) ** 2
        variance = squares / (count - 1) / count if count > 1 else np.full_like(mean, np.nan)
        return cls(mean, variance, samples, count, seconds, images if keep else None)

    def __repr__(self) -> str:
        """Size, mean with its standard error, samples and time, in one line."""
        height, width = self.mean.shape[:2]
        mean = f"{self.mean.mean():.4g}"
        if self.images is not None and self.replicates > 1:
            each = self.images.mean(axis=(1, 2, 3), dtype=np.float64)
            mean += f" ± {each.std(ddof=1) / np.sqrt(self.replicates):.1g}"
        kept = "" if self.images is None else ", kept"
        return (
            f"TermImage({width} x {height}, mean {mean}, {self.samples} samples x {self.replicates} replicates{kept}, "
            f"{self.seconds:.3g} s)"
        )

    def _repr_html_(self) -> str:
        """The picture as a notebook shows it: sRGB, its 99th percentile at 1, small ones enlarged; and `repr`."""
        height, width = self.mean.shape[:2]
        top = max(float(np.percentile(np.nan_to_num(self.mean), 99.0)), np.finfo(float).tiny)
        linear = np.clip(np.nan_to_num(self.mean) / top, 0.0, 1.0)
        png = io.BytesIO()
        PIL.Image.fromarray(np.rint(srgb.encoded(linear) * 255.0).astype(np.uint8)).save(png, "png")
        content = base64.b64encode(png.getvalue()).decode()
        wide = width * max(1, 256 // max(width, height))
        return (
            f'<figure style="margin: 0"><img alt="" src="data:image/png;base64,{content}" '
            f'style="width: {wide}px; max-width: 100%; image-rendering: pixelated">'
            f"<figcaption><code>{html.escape(repr(self))}</code></figcaption></figure>"
        )


def total(*images: np.ndarray) -> np.ndarray:
    """Sum one image of each term in the order of `TERMS`, the one order that makes the sum reproducible to the bit."""
    if len(images) != len(TERMS):
        raise ValueError(f"total of {len(images)} images: allowed is one of each of {', '.join(TERMS)}")
    return functools.reduce(operator.add, images)
