"""Faults that are planted: each an exact replacement in the sources, and the case that shows it.

Those of images are planted where the image leaves the renderer, so that no kernel is compiled anew.
"""

from pathlib import Path

import attrs

from tests.audit.worker import Case


@attrs.frozen
class Plant:
    """A fault: in `path`, `before` becomes `after`."""

    name: str
    case: Case
    path: str
    before: str
    after: str

    def changed(self, root: Path) -> str:
        """The file's text with the fault in it.

        Raises
        ------
        ValueError
            `before` does not occur exactly once: the sources have moved on, and the plant has to follow them.
        """
        text = (root / self.path).read_text("utf-8")
        found = text.count(self.before)
        if found != 1:
            raise ValueError(f"plant {self.name!r}: {self.path}: {found} matches: allowed is exactly one")
        return text.replace(self.before, self.after)


# Samples for a standard error of 0.1 % or less at K = 16.
AMBIENT = Case("cornell_box", "ambient", "cosine", samples=32)
AMBIENT_UNIFORM = Case("cornell_box", "ambient", "uniform", samples=64)
DIRECT = Case("cornell_box", "direct", "next-event", samples=32)
TURNED = Case("turned two_cubes", "direct", "next-event", samples=32)
PATH = Case("cornell_box_unshadowed", "direct", "path", samples=256)
PHOTON_MAP = Case("cornell_box_unshadowed", "direct", "photon-map", samples=16)
SPLIT = Case("cornell_box_unshadowed", "direct", "next-event", samples=16)
GLOSSY = Case("glossy cornell_box", "specular", "vndf", samples=256)
GLOSSY_UNIFORM = Case("glossy cornell_box", "specular", "uniform", samples=1024)
METAL = Case("metal cornell_box", "specular", "vndf", samples=128)
OUTDOORS = Case("glossy two_cubes", "specular", "vndf", samples=512)
BACKGROUND = Case("two_cubes", "background", "seen", samples=32)

_AMBIENT = "renderer/terms/ambient.py"
_DIRECT = "renderer/terms/direct.py"
_SPECULAR = "renderer/terms/specular.py"
_LIGHTS = "renderer/lights/__init__.py"
_FACE = "renderer/lights/face.py"
_ARRIVING = "renderer/lights/arriving.py"
_LOBE = "renderer/microfacet.py"
_TRACING = "renderer/photon_tracing.py"
_TILES = "renderer/engine.py"
_OUT = "yield count, out / taken, seconds"

PLANTS = (
    Plant(
        "ambient: cosine twice",
        AMBIENT,
        _AMBIENT,
        "return square_to_cosine_hemisphere(u, v), 1.0",
        "return square_to_cosine_hemisphere(u, v), square_to_cosine_hemisphere(u, v).z",
    ),
    Plant("ambient: cosine forgotten", AMBIENT_UNIFORM, _AMBIENT, "weight = 2.0 * u", "weight = 1.0"),
    Plant(
        "ambient: range ignored",
        AMBIENT,
        _AMBIENT,
        "return 0.0 if rule == CONSTANT else scene.ambient_range",
        "return 0.0 if rule == CONSTANT else math.inf",
    ),
    Plant(
        "ambient: occlusion drawn but not applied",
        AMBIENT,
        _AMBIENT,
        "scene, waiting, asking, ambient_reach(scene, rule), False, hits.y, out, scratch",
        "scene, waiting, 0, ambient_reach(scene, rule), False, hits.y, out, scratch",
    ),
    Plant(
        "normal not turned to the viewer",
        TURNED,
        "renderer/surface.py",
        "if scene.face_forward and dot(normal, wo) < 0.0:",
        "if scene.face_forward and dot(normal, wo) < -1.0:",
    ),
    Plant(
        "direct: cosine twice",
        DIRECT,
        _ARRIVING,
        "strength *= cos_surface / (square * math.sqrt(square))",
        "strength *= cos_surface * cos_surface / (square * square)",
    ),
    Plant(
        "direct: cosine forgotten",
        DIRECT,
        _ARRIVING,
        "strength *= cos_surface / (square * math.sqrt(square))",
        "strength *= 1.0 / square",
    ),
    Plant(
        "direct: the light's cosine forgotten",
        DIRECT,
        _FACE,
        "* cos_light / (length(direction) * probability)",
        "/ probability",
    ),
    Plant(
        "direct: the light's area twice",
        DIRECT,
        _FACE,
        "INV_PI * faces.area[row] * cos_light",
        "INV_PI * 2.0 * faces.area[row] * cos_light",
    ),
    Plant("direct: 1/pi lost", DIRECT, _FACE, "INV_PI * faces.area[row] * cos_light", "faces.area[row] * cos_light"),
    Plant(
        "light picked with the wrong probability",
        DIRECT,
        _LIGHTS,
        "return low, probability, min(",
        "return low, cdf[low], min(",
    ),
    Plant(
        "direct: distance clamped inside the pdf",
        DIRECT,
        _ARRIVING,
        "    square = dot(direction, direction)\n    strength",
        "    square = max(25.0, dot(direction, direction))\n    strength",
    ),
    Plant(
        "direct: shadow ray too short",
        DIRECT,
        _DIRECT,
        "resolve_occlusion(scene, waiting, asking, 1.0, True, hits.y, out, scratch)",
        "resolve_occlusion(scene, waiting, asking, 0.2, True, hits.y, out, scratch)",
    ),
    Plant(
        "diffuse weight without (1 - g)",
        DIRECT,
        "scenes/model.py",
        "share = 1.0 - material.gloss if self.toggles.reflections else 1.0",
        "share = 1.0",
    ),
    Plant(
        "path: roulette without 1/p",
        PATH,
        _DIRECT,
        "throughput = scale(throughput, 1.0 / survival)",
        "throughput = scale(throughput, 1.0)",
    ),
    Plant(
        "path: albedo of the vertex before",
        PATH,
        _DIRECT,
        "throughput = mul(throughput, diffuse_weight(scene, surface))",
        "throughput = mul(throughput, weight)",
    ),
    Plant(
        "path: ends after one bounce",
        PATH,
        _DIRECT,
        "if sample_1d(sampler, ROULETTE) >= survival:",
        "if vertex == 1 or sample_1d(sampler, ROULETTE) >= survival:",
    ),
    Plant(
        "photons: wrong power",
        PHOTON_MAP,
        _FACE,
        "scale(radiance, math.pi * faces.area[row] / probability)",
        "scale(radiance, 2.0 * math.pi * faces.area[row] / probability)",
    ),
    Plant("photons: power shared by those that land", PHOTON_MAP, _TRACING, "power /= emitted", "power /= len(power)"),
    Plant(
        "photons: stored twice",
        PHOTON_MAP,
        _TRACING,
        "(np.concatenate(parts) for parts in zip(*chunks, strict=True))",
        "(np.concatenate(2 * parts) for parts in zip(*chunks, strict=True))",
    ),
    Plant(
        "photons: roulette without 1/P",
        PHOTON_MAP,
        _TRACING,
        "factor = scale(weight, 1.0 / survival) if rule.weighted else",
        "factor = weight if rule.weighted else",
    ),
    Plant(
        "photons: kernel mass left out at borders",
        PHOTON_MAP,
        "renderer/photon_map.py",
        "mass = kernel_mass(scene, surface.face, x, radius, photons.exponent, scratch.stack)",
        "mass = 1.0",
    ),
    Plant(
        "photons: first hits counted besides light sampling",
        SPLIT,
        _TILES,
        'first_hits=task.stored != "scattered"',
        "first_hits=True",
    ),
    Plant("specular: Fresnel with the exponent 4", GLOSSY, _LOBE, "rise = x2 * x2 * x\n", "rise = x2 * x2\n"),
    Plant(
        "specular: G1 in place of G",
        GLOSSY_UNIFORM,
        _LOBE,
        "beckmann_d(m, alpha) * smith_g1(wi.z, alpha) * smith_g1(wo.z, alpha)",
        "beckmann_d(m, alpha) * smith_g1(wi.z, alpha)",
    ),
    Plant(
        "specular: D with alpha for alpha squared",
        GLOSSY_UNIFORM,
        _LOBE,
        "INV_PI / (alpha * alpha * cos2 * cos2)",
        "INV_PI / (alpha * cos2 * cos2)",
    ),
    Plant(
        "specular: lobe sampled with another roughness",
        GLOSSY,
        _LOBE,
        "m = sample_visible_normal(wo, alpha, u, v)",
        "m = sample_visible_normal(wo, 0.5 * alpha, u, v)",
    ),
    Plant(
        "specular: cosine clamped inside the pdf",
        GLOSSY_UNIFORM,
        _SPECULAR,
        "return wi, scale(dfg, 0.5 * math.pi / wo.z)",
        "return wi, scale(dfg, 0.5 * math.pi / max(0.7, wo.z))",
    ),
    Plant(
        "specular: gloss forgotten",
        GLOSSY,
        _SPECULAR,
        "throughput = scale(mul(throughput, weight), gloss)",
        "throughput = mul(throughput, weight)",
    ),
    Plant(
        "specular: a bounce too few", METAL, _SPECULAR, "bounce < scene.max_bounces:", "bounce < scene.max_bounces - 1:"
    ),
    Plant(
        "specular: sky missing at depth",
        OUTDOORS,
        _SPECULAR,
        "radiance = sky_radiance(scene.sky, origin, direction)",
        "radiance = Vec3(0.0, 0.0, 0.0)",
    ),
    Plant("sky upside down", BACKGROUND, "renderer/sky.py", "u, 0.5 - 0.5 * n.z)", "u, 0.5 + 0.5 * n.z)"),
    Plant(
        "half-pixel shift",
        DIRECT,
        "renderer/camera.py",
        "mad(camera.across, x / camera.width",
        "mad(camera.across, (x + 0.5) / camera.width",
    ),
    Plant(
        "scene file of another scene",
        DIRECT,
        "scenes/library/cornell_box.toml",
        "translation = [-0.905, 0.716, 1.683]",
        "translation = [-0.405, 0.216, 1.683]",
    ),
    Plant("1 % gain", DIRECT, _TILES, _OUT, "yield count, 1.01 * out / taken, seconds"),
    Plant(
        "left and right 2 %",
        DIRECT,
        _TILES,
        _OUT,
        "yield count, out / taken * np.where(np.arange(width) < width // 2, 1.02, 0.98)[:, None], seconds",
    ),
    Plant(
        "a tile off by 10 %",
        DIRECT,
        _TILES,
        _OUT,
        "yield count, out / taken * np.where(np.indices(out.shape)[:2].max(axis=0) < 16, 1.1, 1.0), seconds",
    ),
    Plant(
        "2-px blur",
        DIRECT,
        _TILES,
        _OUT,
        'yield count, __import__("scipy.ndimage").ndimage.gaussian_filter(out / taken, (2, 2, 0)), seconds',
    ),
    Plant("red and blue swapped", DIRECT, _TILES, _OUT, "yield count, (out / taken)[..., ::-1], seconds"),
    Plant(
        "a NaN pixel",
        DIRECT,
        _TILES,
        _OUT,
        "out[3, 5, 1] = np.nan if count == samples else out[3, 5, 1]\n            " + _OUT,
    ),
    Plant(
        "a negative pixel",
        DIRECT,
        _TILES,
        _OUT,
        "out[3, 5, 1] *= -1.0 if count == samples else 1.0\n            " + _OUT,
    ),
    Plant(
        "the same samples in all replicates",
        DIRECT,
        _TILES,
        "key = root(request.seed, request.replicate)",
        "key = root(request.seed, 0)",
    ),
    Plant(
        "replicates with equal seeds by twos",
        DIRECT,
        _TILES,
        "key = root(request.seed, request.replicate)",
        "key = root(request.seed, request.replicate // 2)",
    ),
)
