"""What a scene needs: every piece of work, whether it runs, and why not where it does not.

Two kinds of saving, never mixed. A **skip** is work that cannot contribute: the image is the same to the byte without
it. Each is a row of SKIPS and can be switched off (`Engine(scene, without=...)`), which is how the tests prove it. An
**reduction** takes fewer samples for the same expectation. A **reuse** takes a result that exists.
"""

import functools
import itertools
import math
from collections.abc import Callable, Collection
from typing import Literal, get_args

import attrs
import numpy as np

from termwise.renderer.arrays import FAINT, FEW_EMITTERS, MANY_EMITTERS, emitters_of, light_samples
from termwise.renderer.counts import LEAST_FEW, LEAST_MANY
from termwise.renderer.film import ALONE, primary_hits_of
from termwise.renderer.photon_map import KEPT_BYTES
from termwise.renderer.terms import VARIANTS
from termwise.renderer.terms.variant import CHAINS, Chain, Stored, Variant
from termwise.renderer.unoccluded import open_sides
from termwise.scenes.model import Scene
from termwise.scenes.terms import TABLE, TERMS, Term, first, reads_of

# The box around a sphere: corners, and triangles that have all of its edges.
_CUBE = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_CUBE_EDGES = np.array([[i, i ^ 1 << axis, i ^ 1 << (axis + 1) % 3] for i in range(8) for axis in range(3)])

Kind = Literal["runs", "skip", "variance reduction", "reuse"]


@attrs.frozen
class Skip:
    """Work that cannot contribute.

    Attributes
    ----------
    work : what is not done.
    why : why the image has the same bytes without it.
    reason : scene, variant, chain -> why it applies there, or None; of a skip that is decided at each hit, where.
    """

    name: str
    work: str
    why: str
    reason: Callable[[Scene, Variant, Chain], str | None]


@attrs.frozen
class Reduction(Skip):
    """Fewer samples, or better ones, for the same expectation; `why` it is the same."""


@attrs.frozen
class Step:
    """One piece of work of a term.

    Attributes
    ----------
    kind : "runs", or how the work is saved.
    reason : why it runs, or why it need not.
    saved : the count of work saved, by name of `renderer.scratch.COUNTERS`; empty where it cannot be told beforehand.
    at_most : whether `saved` is a bound: what misses the scene, or is black, would have cost less.
    """

    term: Term
    work: str
    kind: Kind
    reason: str
    saved: dict[str, int] = attrs.field(factory=dict)
    at_most: bool = False

    @property
    def runs(self) -> bool:
        """Whether the work is done."""
        return self.kind == "runs"


def skipped(scene: Scene, term: Term) -> str | None:
    """Why a term is zero everywhere, or None where it has to be rendered."""
    return TABLE[term].absent(scene)


def check(scene: Scene, variant: Variant, *, chain: Chain = "next-event") -> None:
    """Refuse an option that the variant would ignore.

    Raises
    ------
    ValueError : the message names the field, its value and what is allowed.
    """
    if chain not in get_args(Chain):
        raise ValueError(f"chain = {chain!r}: allowed are {', '.join(get_args(Chain))}")
    scattering = scene.photons.scattering
    if scattering == "full" and scene.shadows == "paper":
        raise ValueError(f"{scene.name}: photons.scattering = 'full': allowed is 'diffuse' with shadows = 'paper'")
    if scattering not in variant.scatterings:
        allowed = " or ".join(map(repr, variant.scatterings))
        raise ValueError(
            f"{scene.name}: photons.scattering = {scattering!r}: allowed is {allowed} for {variant.term} {variant.name}"
        )
    if unfit := variant.unfit(scene):
        raise ValueError(f"{scene.name}: {unfit} for {variant.term} {variant.name}")
    # Radiance that leaves a back as if it were the front has no flux that photons could carry.
    if scene.normals == "face" and variant.photons(scene, chain):
        raise ValueError(
            f"{scene.name}: normals = 'face': allowed is 'viewer' for {variant.term} {variant.name}, which needs "
            "photons (without: scope = 'first-hit', or direct path)"
        )


def needs_photons(scene: Scene, variant: Variant, chain: Chain, *, without: Collection[str] = ()) -> Stored | None:
    """Which photons the maps of a variant hold; None where no map is needed."""
    needed = "photons" in without or skipped(scene, "direct") is None
    return variant.photons(scene, chain) if needed else None


def may_see(scene: Scene, term: Term = "background") -> np.ndarray:
    """Pixels whose rays may meet an object that has the term, (H, W) bool; the others see none, for certain.

    Those in the box around the projection of an object, clipped to what lies before the camera. The background has all
    objects, for they hide the sky.
    """
    width, height = scene.resolution
    # The paper's intersection has absolute tolerances: it may find what is not there.
    seen = np.full((height, width), scene.intersection != "watertight")
    for surface, (rows, columns) in zip(scene.surfaces, _windows(scene), strict=True):
        if TABLE[term].has(scene, surface):
            seen[rows, columns] = True
    return seen


@functools.lru_cache(maxsize=4)
def _windows(scene: Scene) -> list[tuple[slice, slice]]:
    """Rows and columns of each object's box, and each sphere's; kept, for each term asks and looks at all vertices."""
    width, height = scene.resolution
    right, up, forward = scene.camera.frame()
    pixels = width / (2.0 * math.tan(math.radians(scene.camera.fov) / 2.0))
    slack = 1e-3  # of a pixel

    def span(values: np.ndarray, size: int) -> slice:
        low, high = np.clip((values.min() - slack, values.max() + slack), -1.0, size + 1.0)
        return slice(max(0, math.floor(low)), max(0, math.floor(high) + 1))

    found = []
    bodies = [(thing.mesh.vertices, thing.mesh.faces) for thing in scene.objects]
    bodies += [(np.array(sphere.center) + sphere.radius * _CUBE, _CUBE_EDGES) for sphere in scene.spheres]
    for vertices, faces in bodies:
        x, y, depth = (np.stack([right, -up, forward]) @ (vertices - scene.camera.position).T)[:, faces.T]
        near = 1e-9 * np.abs(depth).max()
        # Where an edge goes through the plane of the camera, the point just before it takes its place.
        begin, end = [0, 1, 2], [1, 2, 0]
        before, after = depth[begin] - near, depth[end] - near
        crossing = before * after < 0.0
        share = np.divide(before, before - after, out=np.zeros_like(before), where=crossing)
        points = [
            np.concatenate([axis[depth >= near], (axis[begin] + share * (axis[end] - axis[begin]))[crossing]])
            for axis in (x, y)
        ]
        depths = np.concatenate([depth[depth >= near], np.full(np.count_nonzero(crossing), near)])
        if len(depths):
            across = 0.5 * width + pixels * points[0] / depths
            down = 0.5 * height + pixels * points[1] / depths
            found.append((span(down, height), span(across, width)))
        else:
            found.append((slice(0), slice(0)))
    return found


def needs_every_pixel(scene: Scene, term: Term) -> bool:
    """Whether a term has to be sampled where no object can be seen."""
    return TABLE[term].beyond(scene) is None


def _names(names: list[str]) -> str:
    return ", ".join(names) or "none"


def _estimators(variant: Variant, chain: Chain) -> tuple[Variant, ...]:
    """The variant, and those of the other terms at the vertices of its chain."""
    met = CHAINS[chain] if TABLE[variant.term].meets else {}
    return (variant, *(VARIANTS[term][name] for term, name in met.items()))


def _samples_lights(variant: Variant, chain: Chain) -> bool:
    return any(each.samples_lights for each in _estimators(variant, chain))


def _black(scene: Scene, variant: Variant, chain: Chain) -> list[str]:
    # What a chain meets has both terms.
    asked = [each.term for each in _estimators(variant, chain) if each.term in ("ambient", "direct")]
    return [thing.name for term in asked[-1:] for thing in scene.objects if not TABLE[term].has(scene, thing.surface)]


def _open(scene: Scene) -> list[str]:
    sides = open_sides(scene)
    said = {(True, True): "", (True, False): " (front)", (False, True): " (back)"}
    return [
        thing.name + said[front, back]
        for thing, (front, back) in zip(scene.objects, sides.tolist(), strict=True)
        if (front or back) and any(scene.diffuse_weight(thing.surface))
    ]


def _window(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    count = np.count_nonzero(~may_see(scene, variant.term))
    if not count or needs_every_pixel(scene, variant.term):
        return None
    pixels = scene.resolution[0] * scene.resolution[1]
    return f"{count} of {pixels} pixels see {TABLE[variant.term].beyond_is} for certain"


def _pixel(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    # With a photon map a sample a kernel is called for each sample.
    if scene.camera.pixel == "jitter" or needs_photons(scene, variant, chain):
        return None
    return f"all rays of a pixel go through its {scene.camera.pixel}"


def _texture(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    if not TABLE[variant.term].sky:
        return None
    return first(
        (scene.sky.texture is None, "the sky is a constant"), (scene.sky.is_black, "every texel of the sky is black")
    )


def _occlusion(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    # At the vertices of a specular chain as well.
    ambient = [each for each in _estimators(variant, chain) if each.term == "ambient"]
    if not ambient:
        return None
    return first(
        (scene.ambient_light is not None and not scene.occlusion_range, "ambient occlusion is off: L_a0 everywhere"),
        (not any(each.occludes for each in ambient), "the variant is L_a0 itself"),
        (not scene.has_ambient, "the ambient light is black"),
    )


def _openness(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    known = any(each.open_is_one for each in _estimators(variant, chain))
    if not known or scene.ambient_light is None or _occlusion(scene, variant, chain) or not _open(scene):
        return None
    return f"nothing lies within the range of {_names(_open(scene))}: AO = 1"


def _diffuse(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    black = _black(scene, variant, chain)
    return f"color (1 - gloss) (1 - transparency) = 0: {_names(black)}" if black else None


def _horizon(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    if not _samples_lights(variant, chain) or skipped(scene, "direct"):
        return None
    return "the light is below the horizon, or shows its back"


def _maps(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    if variant.photons(scene, chain) is None:
        return None
    return skipped(scene, "direct")


def _throughput(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    return "where a chain's weight is 0" if TABLE[variant.term].meets else None


SKIPS: dict[str, Skip] = {
    skip.name: skip
    for skip in (
        Skip(
            "term",
            "the whole term, its kernel not even compiled",
            "a weight that is 0 everywhere",
            lambda scene, variant, chain: skipped(scene, variant.term),
        ),
        Skip("photons", "photon maps", "no photon, or none that a surface would scatter to the camera", _maps),
        Skip(
            "window",
            "pixels without an object that has the term",
            "no ray through them meets the box of its vertices",
            _window,
        ),
        Skip("pixel", "a pixel's camera rays but the first", "they are one ray", _pixel),
        Skip("texture", "lookups of the sky's texture", "all texels are the constant", _texture),
        Skip("occlusion", "occlusion rays", "their result is not used", _occlusion),
        Skip("open", "occlusion rays of open surfaces", "no face lies within reach", _openness),
        Skip("diffuse", "ambient and direct light on black surfaces", "the weight is 0", _diffuse),
        Skip("horizon", "shadow rays to a light that cannot shine there", "a cosine is 0", _horizon),
        Skip("throughput", "the rest of a chain", "the factor on it is 0", _throughput),
    )
}


def photons_of_a_pass(scene: Scene, variant: Variant, chain: Chain, without: Collection[str] = ()) -> int:
    """How many photons a map is made of: those that are aimed at the scene, see `photon_tracing.Scattering`."""
    if "aimed" in without or variant.by_nearest(scene, chain):
        return scene.photons.count
    return max(1, math.ceil(scene.photons.count * emitters_of(scene).share))


def _aimed(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    if needs_photons(scene, variant, chain) is None or variant.by_nearest(scene, chain):
        return None
    share = emitters_of(scene).share
    return f"{100 * share:.0f} % of the light is emitted towards the scene" if share < 1.0 else None


def _roulette(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    if not TABLE[variant.term].meets or skipped(scene, variant.term):
        return None
    return f"chains of a throughput t below {FAINT:g} go on with probability t / {FAINT:g}"


def _lights(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    count = len(emitters_of(scene).kind)
    few_or_too_many = not FEW_EMITTERS < count <= MANY_EMITTERS
    if few_or_too_many or not _samples_lights(variant, chain) or skipped(scene, variant.term):
        return None
    return f"one of {count} emitters is chosen by what it may send to the point"


def _splitting(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    split, lights = variant.split(scene), light_samples(scene)
    if split > 1:
        return f"after {ALONE} samples, {split} leave what one of them sees"
    if lights > 1 and variant.several_lights and skipped(scene, "direct") is None:
        return f"{lights} light samples stand beside one estimate by photons"
    return None


def by_contrast(scene: Scene, variant: Variant, chain: Chain, without: Collection[str] = ()) -> bool:
    """Whether the contrast between its corners says how many samples a pixel gets.

    Not with a photon map, which is for all pixels, and not where all rays of a pixel are one: corners differ where
    samples do not.
    """
    serves = variant.by_contrast and "counts" not in without and scene.camera.pixel == "jitter"
    return serves and needs_photons(scene, variant, chain) is None


def _counts(scene: Scene, variant: Variant, chain: Chain) -> str | None:
    if not by_contrast(scene, variant, chain) or skipped(scene, variant.term):
        return None
    begin = f"beyond {LEAST_FEW} samples where few pixels hold the noise, else {LEAST_MANY}"
    return f"{begin}, one at each corner of a pixel says how much it varies: N / 4 to 16 N"


REDUCTIONS: dict[str, Reduction] = {
    reduction.name: reduction
    for reduction in (
        Reduction("aimed", "photons that meet nothing", "those in the cone around the scene carry its flux", _aimed),
        Reduction("counts", "samples where little varies", "what is known before a run decides", _counts),
        Reduction("lights", "samples of far lights", "each is as likely as its light at the point", _lights),
        Reduction("splitting", "camera rays", "each sample's point is as likely as with a ray of its own", _splitting),
        Reduction("roulette", "faint chains", "those that go on carry the light of all", _roulette),
    )
}


def plan(
    scene: Scene,
    variants: dict[Term, Variant],
    *,
    chain: Chain = "next-event",
    samples: int | dict[Term, int] = 1,
    without: Collection[str] = (),
    together: bool = False,
) -> tuple[Step, ...]:
    """The steps of rendering `scene` with the given variants, `samples` a pixel, for one replicate.

    `together`: the terms are rendered by one engine that keeps photon maps (`renderer.render_terms`).
    """
    counts = samples if isinstance(samples, dict) else dict.fromkeys(TERMS, samples)
    steps = [step for term in TERMS for step in _steps(scene, variants[term], chain, counts[term], frozenset(without))]
    if not together:
        return tuple(steps)
    return tuple(_with_shared_maps(scene, variants, chain, counts, steps, frozenset(without)))


def _with_shared_maps(
    scene: Scene,
    variants: dict[Term, Variant],
    chain: Chain,
    counts: dict[Term, int],
    steps: list[Step],
    without: frozenset[str],
) -> list[Step]:
    """The steps, photon maps of a chain taken from direct where both mean the same photons."""
    if not any((step.term, step.work, step.runs) == ("direct", "photon maps", True) for step in steps):
        return steps

    def shared(step: Step) -> Step:
        of_chain = step.work == "photon maps" and step.runs and bool(TABLE[step.term].meets)
        if not (of_chain and _same_maps(scene, variants["direct"], variants[step.term], chain)):
            return step
        passes = min(counts["direct"], counts[step.term])
        emitted = passes * photons_of_a_pass(scene, variants[step.term], chain, without)
        saved = f"those of direct, as far as {KEPT_BYTES >> 20} MB hold them"
        return Step(step.term, "photon maps", "reuse", saved, {"photons": emitted}, at_most=True)

    return [shared(step) for step in steps]


def _same_maps(scene: Scene, direct: Variant, other: Variant, chain: Chain) -> bool:
    """Whether direct and the chain of another term mean the same photons."""
    kinds = {(each.photons(scene, chain), each.by_nearest(scene, chain)) for each in (direct, other)}
    return len(kinds) == 1 and scene.photons.scattering == "diffuse"


def powers_of_two(samples: int) -> tuple[int, ...]:
    """1, 2, 4, ... below `samples`, then `samples`: the prefixes of a run."""
    return (*(2**i for i in range((samples - 1).bit_length())), samples)


def camera_rays(samples: int, split: int) -> int:
    """Camera rays of a pixel, `split` samples to one, in all prefixes of a run."""
    parts = itertools.pairwise((0, *powers_of_two(samples)))
    return sum(end - begin for begin, end in (primary_hits_of(first, last, split) for first, last in parts))


def _images(scene: Scene, term: Term) -> str:
    """The images of a scene's objects that a term reads."""
    of_surfaces = any(field.startswith("objects.material.") for each in reads_of(term) for field in each.fields)
    of_lamps = TABLE[term].scoped if term != "background" else scene.shows_lights
    return ", ".join(
        f"{name} of {thing.name} ({image.texels.shape[1]} x {image.texels.shape[0]})"
        for thing in scene.objects
        for name, image in thing.images.items()
        if (of_lamps if name == "emission" else of_surfaces)
    )


def _steps(scene: Scene, variant: Variant, chain: Chain, samples: int, without: frozenset[str]) -> list[Step]:
    term = variant.term
    pixels = scene.resolution[0] * scene.resolution[1]
    split = 1 if "splitting" in without else variant.split(scene)
    hits = camera_rays(samples, split)
    applied = {
        name: reason
        for name, skip in SKIPS.items()
        if name not in without and (reason := skip.reason(scene, variant, chain))
    }
    kernel = f"kernel {variant.estimator.name} ({variant.name})"
    if "term" in applied:
        return [Step(term, kernel, "skip", applied["term"], {"rays": hits * pixels}, at_most=False)]
    why = f"auto: {variant.chosen}" if variant.chosen else "the scene has this term"
    steps = [Step(term, kernel, "runs", why)]
    outside = hits * int(np.count_nonzero(~may_see(scene, term)))

    def skip(name: str, work: str, *, at_most: bool = False, **saved: int) -> None:
        counts = {counter.replace("_", " "): count for counter, count in saved.items()}
        steps.append(Step(term, work, "skip", applied[name], counts, at_most))

    if "splitting" not in without and (reason := REDUCTIONS["splitting"].reason(scene, variant, chain)):
        spared = (samples - hits) * pixels
        if spared:
            work = REDUCTIONS["splitting"].work
            steps.append(Step(term, work, "variance reduction", reason, {"rays": spared}, at_most=True))
        elif split == 1:
            spared = (light_samples(scene) - 1) * samples * pixels
            counts = {"rays": spared, "density estimates": spared}
            steps.append(Step(term, "estimates by photons", "variance reduction", reason, counts, at_most=True))
    if "window" in applied:
        skip("window", "pixels without such objects", rays=outside)
    if "pixel" in applied:
        calls = 1 + (samples - 1).bit_length()  # of the kernel, one a prefix
        skip("pixel", "a pixel's further camera rays", at_most=True, rays=(hits - calls) * pixels)
    if term == "ambient":
        if "occlusion" in applied:
            skip("occlusion", "occlusion rays", at_most=True, occlusion_rays=samples * pixels)
        else:
            steps.append(Step(term, "occlusion rays", "runs", "one a sample that hits"))
    if "open" in applied:
        skip("open", "open surfaces")
    if "diffuse" in applied:
        skip("diffuse", "black surfaces")
    crossed = any(each.term in ("ambient", "direct") for each in _estimators(variant, chain))
    if scene.translucent and crossed:
        names = _names([thing.name for thing in scene.translucent])
        steps.append(Step(term, "light of the other side", "runs", f"it crosses {names}"))
    if scene.unshadowing and crossed:
        names = _names([thing.name for thing in scene.unshadowing])
        steps.append(Step(term, "light through glass", "runs", f"shadow and occlusion rays go through {names}"))
    if scene.transparent and TABLE[term].meets:
        names = _names([thing.name for thing in scene.transparent])
        steps.append(Step(term, "light of both lobes", "runs", f"chains are reflected by {names} or go through"))
    if "horizon" in applied:
        steps.append(Step(term, "shadow rays", "runs", "one a light sample"))
        skip("horizon", "unlit shadow rays")
    stored = variant.photons(scene, chain)
    emitted = photons_of_a_pass(scene, variant, chain, without)
    if "photons" in applied:
        skip("photons", "photon maps", photons=samples * emitted)
    elif stored:
        why = f"{emitted} photons a pass, {stored} kept, radius {scene.photons.radius:g} at first"
        steps.append(Step(term, "photon maps", "runs", why))
        if "aimed" not in without and (reason := REDUCTIONS["aimed"].reason(scene, variant, chain)):
            spared = samples * (scene.photons.count - emitted)
            steps.append(Step(term, REDUCTIONS["aimed"].work, "variance reduction", reason, {"photons": spared}))
    elif term == "direct":
        steps.append(Step(term, "photon maps", "skip", variant.no_maps, {"photons": samples * emitted}))
    if images := _images(scene, term):
        steps.append(Step(term, "images of surfaces", "runs", f"{images}; bilinear"))
    if TABLE[term].sky and not scene.sky.is_black:
        if "texture" in applied:
            skip("texture", "sky texture")
        else:
            steps.append(Step(term, "sky texture", "runs", f"{scene.sky.projection}, bilinear"))
    if "throughput" in applied:
        skip("throughput", "black chains")
    for name in ("counts", "lights", "roulette"):
        if name not in without and (reason := REDUCTIONS[name].reason(scene, variant, chain)):
            steps.append(Step(term, REDUCTIONS[name].work, "variance reduction", reason))
    return steps
