"""Faults that are planted: each an exact replacement in the sources, and what shows it.

Those of images are planted where the image leaves the renderer, so that no kernel is compiled anew. Faults that are in
no image, of caches, pages and files, stand in `tests.audit.unseen`.
"""

from pathlib import Path

import attrs

from tests.audit.worker import Case


@attrs.frozen
class Test:
    """A test that is to fail, by its name for pytest; kernels are plain Python unless it is `compiled`."""

    name: str
    compiled: bool = False

    # It is no test itself.
    __test__ = False

    def __str__(self) -> str:
        """As tables name it."""
        return self.name.removeprefix("tests/")


@attrs.frozen
class Plant:
    """A fault: in `path`, `before` becomes `after`.

    Attributes
    ----------
    shown : the case whose verdict is to catch it, or the test.
    tolerated : whether the verdict tolerates what is so small, if its sentence says that it is proven.
    """

    name: str
    shown: Case | Test
    path: str
    before: str
    after: str
    tolerated: bool = False

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
# As large as the library's pictures: a border or a small object is a small part of them.
WIDE = Case("two_cubes", "direct", "path", samples=1, side=128)
DIM = Case("metal cornell_box", "specular", "vndf", samples=4, side=128)
FEW = Case("cornell_box_unshadowed", "direct", "next-event", samples=2)
SMOOTH = Case("smooth monkey", "direct", "path", samples=64)
FAINT = Case("faint cornell_box", "specular", "vndf", samples=256)
STEEL = Case("two_cubes", "specular", "vndf", samples=128)
CONSTANT_SKY = Case("monkey", "background", "seen", samples=32)
PANORAMA = Case("panorama two_cubes", "background", "seen", samples=32)
FLAT = Case("two_cubes", "background", "seen", samples=32, side=48, height=24)
OUTSIDE = Case("two_cubes", "direct", "path", samples=64)
COUNTED = Case("cornell_box", "direct", "next-event", samples=32)
LAMPS = Case("lamps two_cubes", "direct", "path", samples=64)
AIMED = Case("monkey", "direct", "photon-map", samples=16)
SHARP = Case("sharp cornell_box_unshadowed", "direct", "photon-map", samples=16)
NEAREST = Case("cornell_box_unshadowed", "direct", "nearest", samples=16)
SHARED = Case("cornell_box_unshadowed", "direct", "next-event", samples=16, after="photon-map")
MESH = Case("monkey", "ambient", "cosine", samples=32)
SHADOWED = Case("shadowed cornell_box", "direct", "next-event", samples=32)
BRIGHT = Case("bright cornell_box", "direct", "next-event", samples=32)
SPOT = Case("spot lights", "direct", "path", samples=64)
SPOT_PHOTONS = Case("spot lights", "direct", "photon-map", samples=16)
DIRECTIONAL = Case("directional lights", "direct", "path", samples=64)
DIRECTIONAL_PHOTONS = Case("directional lights", "direct", "photon-map", samples=16)
WIDE_SUN = Case("wide sun lights", "direct", "path", samples=256)
SUN_PHOTONS = Case("wide sun lights", "direct", "photon-map", samples=16)
SPHERE = Case("sphere lights", "direct", "path", samples=256)
SPHERE_PHOTONS = Case("sphere lights", "direct", "photon-map", samples=16)
SKYLIT = Case("skylit two_cubes", "ambient", "cosine", samples=64)
IMAGES = Case("textured two_cubes", "ambient", "cosine", samples=64)
GLOSSY_IMAGES = Case("textured glossy two_cubes", "direct", "path", samples=64)
GRAINED = Case("textured grained two_cubes", "specular", "vndf", samples=512)
SCREEN = Case("screened cornell_box", "direct", "path", samples=64)
SCREEN_PHOTONS = Case("screened cornell_box_unshadowed", "direct", "photon-map", samples=16)
SCREEN_DRAWN = Case("drawn screened leaf", "background", "seen", samples=64)
ALL_LIGHTS = Case("lights", "direct", "path", samples=256)
LEAF_AMBIENT = Case("leaf", "ambient", "cosine", samples=64)
LEAF = Case("leaf", "direct", "path", samples=256)
LEAF_SPLIT = Case("leaf", "direct", "next-event", samples=16)
LEAF_BEHIND = Case("behind leaf", "direct", "next-event", samples=16)
LEAF_PHOTONS = Case("leaf", "direct", "photon-map", samples=16)
GLASS = Case("deep glass", "transmission", "vndf", samples=256)
GLASS_FROSTED = Case("deep frosted glass", "transmission", "vndf", samples=256)
GLASS_UNIFORM = Case("deep frosted glass", "transmission", "uniform", samples=512)
GLASS_SPECULAR = Case("deep glass", "specular", "vndf", samples=1024)
THIN = Case("thin glass", "direct", "path", samples=256)
THIN_AMBIENT = Case("thin glass", "ambient", "cosine", samples=64)
THIN_PHOTONS = Case("thin glass", "direct", "photon-map", samples=16)
POOL = Case("pool two_cubes", "transmission", "vndf", samples=256)

_AMBIENT = "renderer/terms/ambient.py"
_DIRECT = "renderer/terms/direct.py"
_SPECULAR = "renderer/terms/specular.py"
_LIGHTS = "renderer/lights/__init__.py"
_SAMPLING = "renderer/light_sampling.py"
_FACE = "renderer/lights/face.py"
_SPOT = "renderer/lights/spot.py"
_DIRECTIONAL = "renderer/lights/directional.py"
_SUN = "renderer/lights/sun.py"
_SPHERE = "renderer/lights/sphere.py"
_DISTANT = "renderer/lights/distant.py"
_ARRIVING = "renderer/lights/arriving.py"
# Of light sample i, before what uses it.
_COSINE = (
    "n, w = column(samples.normal, i), column(samples.way, i)\n"
    "            cosine = (n.x * w.x + n.y * w.y + n.z * w.z) / (w.x * w.x + w.y * w.y + w.z * w.z) ** 0.5\n"
)
_MATERIAL = "renderer/material.py"
_DIELECTRIC = "renderer/dielectric.py"
_LOBE = "renderer/microfacet.py"
_TRACING = "renderer/photon_tracing.py"
_TILES = "renderer/engine.py"
_CAMERA = "renderer/camera.py"
_SKY = "renderer/sky.py"
_IMAGE = "renderer/textures.py"
_MODEL = "scenes/model.py"
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
        "scale(weight, 0.0 if found else 1.0)",
        "scale(weight, 1.0)",
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
        _DIRECT,
        "straight = scale(column(samples.irradiance, i), share)",
        f"{_COSINE}            straight = scale(column(samples.irradiance, i), share * max(cosine, 0.0))",
    ),
    Plant(
        "direct: cosine forgotten",
        DIRECT,
        _DIRECT,
        "straight = scale(column(samples.irradiance, i), share)",
        f"{_COSINE}            straight = scale(column(samples.irradiance, i), share / max(cosine, 1e-6))",
    ),
    Plant("direct: the light's cosine forgotten", DIRECT, _SAMPLING, "(cos_light * near)", "near"),
    Plant("direct: the light's area twice", DIRECT, _SAMPLING, "splat(INV_PI * faces", "splat(2.0 * INV_PI * faces"),
    Plant("direct: 1/pi lost", DIRECT, _SAMPLING, "splat(INV_PI * faces", "splat(faces"),
    Plant(
        "light picked with the wrong probability",
        DIRECT,
        _SAMPLING,
        "probability = emitters.cdf[index + 1] - emitters.cdf[index]",
        "probability = emitters.cdf[index + 1]",
    ),
    Plant(
        "direct: distance clamped inside the pdf",
        DIRECT,
        _SAMPLING,
        "near = one / (x * x + y * y + z * z)",
        "near = minimum(one / (x * x + y * y + z * z), splat(1.0 / 25.0, 8))",
    ),
    Plant(
        "direct: shadow ray too short",
        DIRECT,
        _DIRECT,
        "occlude_wave(scene, wave, asking, 1.0, coherent, scratch)",
        "occlude_wave(scene, wave, asking, 0.2, coherent, scratch)",
    ),
    Plant(
        "diffuse weight without (1 - g)",
        DIRECT,
        "scenes/model.py",
        "share = 1.0 - least(material.gloss) if self.toggles.reflections else 1.0",
        "share = 1.0",
    ),
    Plant(
        "path: roulette without 1/p",
        PATH,
        _DIRECT,
        "put(paths.throughput, path, scale(throughput, 1.0 / survival))",
        "put(paths.throughput, path, throughput)",
    ),
    Plant(
        "path: albedo of the first vertex at all",
        PATH,
        _DIRECT,
        "throughput = mul(vec3(paths.throughput, path), diffuse_weight(scene, surface))",
        "throughput = mul(vec3(paths.throughput, path), vec3(paths.weight, path))",
    ),
    Plant(
        "path: ends after one bounce",
        PATH,
        _DIRECT,
        "if not survives(survival, scratch.u[k]):",
        "if paths.vertex[path] == 1 or not survives(survival, scratch.u[k]):",
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
        "renderer/photon_density.py",
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
        "return wi, scale(mul(throughput, weight), gloss), spread",
        "return wi, mul(throughput, weight), spread",
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
        "mad(camera.across, x, camera.corner)",
        "mad(camera.across, x + 0.5, camera.corner)",
    ),
    Plant(
        "scene file of another scene",
        DIRECT,
        "scenes/library/cornell_box.toml",
        "translation = [-0.905, 0.716, 1.683]",
        "translation = [-0.905, 0.416, 1.683]",
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
        "out[3, 5, 1] = np.nan if count == request.samples else out[3, 5, 1]\n            " + _OUT,
    ),
    Plant(
        "a negative pixel",
        DIRECT,
        _TILES,
        _OUT,
        "out[3, 5, 1] *= -1.0 if count == request.samples else 1.0\n            " + _OUT,
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
    # What a mean, or a block of 2 px, cannot see.
    Plant(
        "colours that cancel in luminance, left against right",
        WIDE,
        _TILES,
        _OUT,
        """image, left = out / taken, np.arange(width) < width // 2
            red = image[..., 0] * np.where(left, 0.3, -0.3 * image[:, left, 0].sum() / image[:, ~left, 0].sum())
            image += red[..., None] * np.array([1.0, -0.2126 / 0.7152, 0.0])
            yield count, image, seconds""",
    ),
    Plant(
        "checkerboard of single pixels",
        WIDE,
        _TILES,
        _OUT,
        "yield count, out / taken * (1.0 + 0.5 * (-1.0) ** np.indices(out.shape[:2]).sum(axis=0))[..., None], seconds",
    ),
    Plant(
        "the last row 10 % darker",
        WIDE,
        _TILES,
        _OUT,
        "yield count, out / taken * np.where(np.arange(height) == height - 1, 0.9, 1.0)[:, None, None], seconds",
    ),
    Plant(
        "the first column 25 % brighter",
        WIDE,
        _TILES,
        _OUT,
        "yield count, out / taken * np.where(np.arange(width) == 0, 1.25, 1.0)[:, None], seconds",
    ),
    Plant(
        "the last row of a dim term halved",
        DIM,
        _TILES,
        _OUT,
        "yield count, out / taken * np.where(np.arange(height) == height - 1, 0.5, 1.0)[:, None, None], seconds",
    ),
    Plant(
        "30 px of no known object 30 % brighter",
        WIDE,
        _TILES,
        _OUT,
        """y, x = np.indices(out.shape[:2])
            yield count, out / taken * np.where((y // 5 == 18) & (x // 6 == 10), 1.3, 1.0)[..., None], seconds""",
    ),
    Plant(
        "one point of the light for all pixels and replicates",
        FEW,
        _DIRECT,
        "draw_2d(scratch.pixel, scratch.sample, count, LIGHT, samples.u, samples.v, scratch.words)",
        "scratch.pixel[:] = np.uint64(7); "
        "draw_2d(scratch.pixel, scratch.sample, count, LIGHT, samples.u, samples.v, scratch.words)",
    ),
    Plant("photons: power less by 1 %", PHOTON_MAP, _TRACING, "power /= emitted", "power *= 0.99 / emitted"),
    Plant(
        "smooth normals not made unit vectors",
        SMOOTH,
        "renderer/triangles.py",
        "    return normalize(\n        Vec3(\n            b0 * n",
        "    return (\n        Vec3(\n            b0 * n",
    ),
    Plant(
        "sky half a texel to the side",
        BACKGROUND,
        _SKY,
        "x = u * sky.texture.shape[1] - 0.5",
        "x = u * sky.texture.shape[1]",
        tolerated=True,
    ),
    Plant(
        "specular: roulette without 1/p",
        FAINT,
        _SPECULAR,
        "throughput = scale(throughput, 1.0 / survival)",
        "throughput = scale(throughput, 1.0)",
    ),
    # The plan.
    Plant(
        "plan: an object's last row and column taken for empty",
        STEEL,
        "renderer/plan.py",
        "return slice(max(0, math.floor(low)), max(0, math.floor(high) + 1))",
        "return slice(max(0, math.floor(low)), max(0, math.floor(high)))",
    ),
    Plant(
        "plan: a lamp taken for no light",
        DIRECT,
        _MODEL,
        "(any(map(shines, self.lights)) or any(thing.emits for thing in self.objects))",
        "any(map(shines, self.lights))",
    ),
    Plant(
        "plan: constant sky beyond the window a sample short",
        CONSTANT_SKY,
        _TILES,
        "for _ in range(samples):\n            summed = summed + constant",
        "for _ in range(samples - 1):\n            summed = summed + constant",
    ),
    # Prefixes and passes.
    Plant(
        "prefixes: each begins with the first sample again", DIRECT, _TILES, "begin, done = end, last", "done = last"
    ),
    Plant(
        "prefixes: the last sample of each taken twice",
        DIRECT,
        _TILES,
        "self._add(driver, inputs, key, items, begin, end,",
        "self._add(driver, inputs, key, items, np.maximum(begin - 1, 0).astype(np.int32), end,",
    ),
    Plant(
        "passes: the radius taken for a diameter",
        PHOTON_MAP,
        _TILES,
        "radius=photon_map.progressive_radius(photons.radius, index),",
        "radius=2.0 * photon_map.progressive_radius(photons.radius, index),",
    ),
    Plant(
        "kept maps: those of all photons taken for the scattered ones",
        SHARED,
        _TILES,
        "name = (key, index, task.stored, self._scattering(task))",
        "name = (key, index)",
    ),
    # Counts by contrast.
    Plant("counts: sums divided by the mean count", COUNTED, _TILES, _OUT, "yield count, out / count, seconds"),
    Plant(
        "counts: a run goes on where even ones would",
        COUNTED,
        _TILES,
        "begin, done = end, last",
        "begin, done = np.full_like(end, last), last",
    ),
    # Aimed photons, and what they land in.
    Plant(
        "aimed photons: the flux of the whole sphere",
        AIMED,
        "renderer/lights/point.py",
        "flux = scale(intensity, 2.0 * math.pi * (1.0 - cosine) / probability)",
        "flux = scale(intensity, 4.0 * math.pi / probability)",
    ),
    Plant("aimed photons: divided by the count of all", AIMED, _TRACING, "power /= emitted", "power /= count"),
    Plant(
        "aimed photons: a cone around half of the vertices",
        AIMED,
        "renderer/lights/aim.py",
        "cosine = float((directions @ axis).min()) - _ROUNDING",
        "cosine = float(np.median(directions @ axis))",
    ),
    Plant(
        "photons: those of the next cell left out",
        PHOTON_MAP,
        "renderer/photon_map.py",
        "_cell(x.x + radius, low.x, cell, photons.nx),",
        "_cell(x.x, low.x, cell, photons.nx),",
    ),
    Plant(
        "photons: the mass of Epanechnikov's kernel at borders",
        SHARP,
        "renderer/kernel_mass.py",
        "return d * t * s * (2.0 - mean)",
        "return d * t * s * (2.0 - 0.5 * mean)",
    ),
    Plant(
        "photons: k for k - 1 of the nearest",
        NEAREST,
        _DIRECT,
        "return (scene.photons.nearest - 1) / scene.photons.nearest if unbiased else 1.0",
        "return 1.0",
    ),
    # Lights by their running sum, and by what they send.
    Plant(
        "lights: the rest of the number not stretched",
        DIRECT,
        _SAMPLING,
        "u = minimum((u - before) * stretch, splat(BELOW_ONE, 8))",
        "u = minimum(u, splat(BELOW_ONE, 8))",
    ),
    Plant(
        "lights: picked by what they send, weighed as if alike",
        LAMPS,
        _LIGHTS,
        "return last, its / total, min(",
        "return last, 1.0 / count, min(",
    ),
    Plant(
        "lights: points of a triangle on one half of it",
        DIRECT,
        _SAMPLING,
        "b1 = choose(up, u * half, u - v * half)",
        "b1 = choose(up, u * half, u)",
    ),
    Plant(
        "path: roulette by the numbers of the direction",
        PATH,
        _DIRECT,
        "draw_2d(scratch.key, scratch.sample, count, ROULETTE, scratch.u, scratch.v, scratch.words)",
        "draw_2d(scratch.key, scratch.sample, count, BOUNCE, scratch.u, scratch.v, scratch.words)",
    ),
    Plant(
        "splitting: the last sample of a shared camera ray lost",
        AMBIENT,
        "renderer/film.py",
        "min(last, _first_of(hit + 1, split))",
        "min(last, _first_of(hit + 1, split) - split // 2)",
    ),
    # Spot, directional light and sun.
    Plant(
        "spot: falloff squared",
        SPOT,
        _SPOT,
        "return (cutoff - angle) / (cutoff - beam)",
        "return ((cutoff - angle) / (cutoff - beam)) ** 2",
    ),
    Plant("spot: no falloff", SPOT, _SPOT, "if angle <= beam:", "if angle < cutoff:"),
    Plant(
        "spot: photons over the sphere",
        SPOT_PHOTONS,
        _SPOT,
        "square_to_uniform_cone(way[0], way[1], cosine)",
        "square_to_uniform_cone(way[0], way[1], -1.0)",
    ),
    Plant(
        "spot: all photons alike",
        SPOT_PHOTONS,
        _SPOT,
        "falloff(scene, row, direction) * solid_angle / probability",
        "solid_angle / probability",
    ),
    Plant(
        "directional: cosine forgotten",
        DIRECTIONAL,
        _DIRECTIONAL,
        "scale(vec3(directionals.irradiance, row), cosine * INV_PI / probability)",
        "scale(vec3(directionals.irradiance, row), INV_PI / probability)",
    ),
    Plant(
        "directional: photons of the floor's irradiance",
        DIRECTIONAL_PHOTONS,
        _DIRECTIONAL,
        "math.pi * ball.radius * ball.radius / probability",
        "math.pi * ball.radius * ball.radius * abs(heading.z) / probability",
    ),
    Plant(
        "distant light: shadow rays that end in the scene",
        DIRECTIONAL,
        _DISTANT,
        "scale(direction, 4.0 * ball.radius)",
        "scale(direction, 0.05 * ball.radius)",
    ),
    Plant(
        "distant light: photons through a square's share of the disc",
        SUN_PHOTONS,
        _DISTANT,
        "Vec3(ball.radius * point.x, ball.radius * point.y, 0.0)",
        "Vec3(0.9 * ball.radius * point.x, ball.radius * point.y, 0.0)",
    ),
    Plant(
        "sun: irradiance for radiance times solid angle",
        WIDE_SUN,
        _SUN,
        "(2.0 / (1.0 + np.cos(angle)))",
        "(1.0 + 0.0 * angle)",
    ),
    Plant(
        "sun: its diameter taken for the half of it",
        WIDE_SUN,
        _MODEL,
        "return math.radians(self.angle) / 2.0",
        "return math.radians(self.angle)",
    ),
    Plant(
        "sphere: wrong density of the cone",
        SPHERE,
        _SPHERE,
        "below = sine / (1.0 + math.sqrt(1.0 - sine))",
        "below = 0.5 * sine",
    ),
    Plant(
        "sphere: half of its photons' flux",
        SPHERE_PHOTONS,
        _SPHERE,
        "4.0 * math.pi**2 * radius * radius / probability",
        "2.0 * math.pi**2 * radius * radius / probability",
    ),
    Plant(
        "sphere: casts no shadow",
        ALL_LIGHTS,
        "renderer/spheres.py",
        "and distance_to(spheres, index, origin, direction) < far",
        "and distance_to(spheres, index, origin, direction) < 0.0",
    ),
    Plant(
        "sky's light: drawn by the map without its Jacobian",
        SKYLIT,
        "renderer/sky_light.py",
        "* distance * distance / (sky.radius * half)",
        "* 1.0",
    ),
    Plant(
        "sky's light: half of the directions not weighed",
        SKYLIT,
        "renderer/sky_light.py",
        "density = 0.5 * (cosine + density_of_sky(scene, sky_map, origin, direction))",
        "density = cosine",
    ),
    # Light that crosses.
    Plant("translucency: s for 1 - s", LEAF_AMBIENT, _MATERIAL, "crosses = u < share", "crosses = u < 1.0 - share"),
    Plant(
        "translucency: an open side taken for both",
        Test("tests/kernels/test_translucency.py::test_ambient_light_is_hidden_on_one_side"),
        _MATERIAL,
        "return sees and scene.materials.open[surface.object, 1 if front else 0]",
        "return sees",
    ),
    Plant(
        "translucency: light of both sides, as much of each",
        LEAF,
        _DIRECT,
        "return mad(back, share, scale(front, 1.0 - share))",
        "return mad(back, 0.5, scale(front, 0.5))",
    ),
    Plant(
        "translucency: paths stay on their side",
        LEAF,
        _MATERIAL,
        "return Vec3(local.x, local.y, -local.z) if crosses else local",
        "return local",
    ),
    Plant(
        "translucency: all of the light stays, and what crosses besides",
        LEAF_BEHIND,
        _DIRECT,
        "front = _of_both(front, column(samples.irradiance, k), scratch.share[k])",
        "front = mad(column(samples.irradiance, k), scratch.share[k], front)",
    ),
    Plant(
        "translucency: what crosses tinted twice",
        LEAF_SPLIT,
        _DIRECT,
        "front = _of_both(front, column(samples.irradiance, k), scratch.share[k])",
        "front = _of_both(front, mul(vec3(scratch.weight, k), column(samples.irradiance, k)), scratch.share[k])",
    ),
    Plant(
        "translucency: photons of the back dropped",
        LEAF_PHOTONS,
        "renderer/surface.py",
        "s.face, s.object, -s.side,",
        "s.face, s.object, s.side,",
    ),
    Plant(
        "translucency: photons stay on their side",
        LEAF_PHOTONS,
        _TRACING,
        "wi = scattered(scene.materials.translucency, surface, u, v)",
        "wi = scattered(None, surface, u, v)",
    ),
    # Transparency.
    Plant(
        "transmission: radiance not squeezed, eta² forgotten",
        POOL,
        _DIELECTRIC,
        "        spread = 1.0 / (eta * eta)\n",
        "        spread = 1.0\n",
    ),
    Plant(
        "transmission: inside and outside exchanged",
        GLASS,
        _MATERIAL,
        "if dot(outwards, surface.normal) < 0.0:",
        "if dot(outwards, surface.normal) >= 0.0:",
    ),
    Plant("transmission: no total reflection", GLASS, _DIELECTRIC, "return 0.0 if eta == 1.0 else 1.0", "return 0.0"),
    Plant(
        "transmission: tinted where it enters alone",
        GLASS,
        _DIELECTRIC,
        "return wi, scale(interface.transmission, weight), spread",
        "clear = max_component(interface.transmission) * weight\n"
        "        return wi, scale(interface.transmission, weight) if eta > 1.0 else Vec3(clear, clear, clear), spread",
    ),
    Plant(
        "transmission: Fresnel's of the surface in the place of the facet's",
        POOL,
        _DIELECTRIC,
        "    reflected, refracted = _sent(interface, cos)\n    crosses",
        "    reflected, refracted = _sent(interface, wo.z)\n    crosses",
    ),
    Plant(
        "transmission: Fresnel's of one polarisation",
        GLASS_SPECULAR,
        _DIELECTRIC,
        "return 0.5 * (parallel * parallel + across * across)",
        "return across * across",
    ),
    Plant(
        "transmission: nothing masked beyond",
        GLASS_FROSTED,
        _DIELECTRIC,
        "* smith_g1(-wi.z, alpha) * spread",
        "* spread",
    ),
    Plant(
        "transmission: refracted by the inverse index",
        GLASS,
        _DIELECTRIC,
        "return mad(m, cos / eta - beyond, scale(wo, -1.0 / eta))",
        "beyond = math.sqrt(max(0.0, _root(cos, 1.0 / eta))) * eta\n"
        "    return mad(m, cos * eta - beyond, scale(wo, -eta))",
    ),
    Plant(
        "transmission: a chain goes on through surfaces alone", GLASS, _SPECULAR, "                way = EITHER\n", ""
    ),
    Plant(
        "transmission: a lobe drawn by its share, and weighed by it again",
        GLASS,
        _DIELECTRIC,
        "total = reflected + refracted if way == EITHER else",
        "total = (refracted if crosses else reflected) if way == EITHER else",
    ),
    Plant(
        "transmission: uniform directions of the sphere, weighed as of half of it",
        GLASS_UNIFORM,
        _DIELECTRIC,
        "solid_angle = 4.0 * math.pi if way == EITHER else 2.0 * math.pi",
        "solid_angle = 2.0 * math.pi",
    ),
    Plant(
        "transmission: the facet that refracts without the index",
        GLASS_UNIFORM,
        _DIELECTRIC,
        "sum_ = add(wo, scale(wi, eta))",
        "sum_ = add(wo, scale(wi, math.sqrt(eta)))",
    ),
    Plant(
        "glass without a shadow: tinted by the last face alone",
        THIN,
        "renderer/surface.py",
        "left = mul(left, share)",
        "left = share",
    ),
    Plant(
        "glass without a shadow: what is behind it hides nothing",
        THIN_AMBIENT,
        "renderer/surface.py",
        "        if is_black(share):\n            return share\n",
        "        if is_black(share):\n            break\n",
    ),
    Plant(
        "glass without a shadow: an edge passed twice",
        Test("tests/kernels/test_glass_shadows.py::test_through_an_edge_is_one_passage"),
        "renderer/surface.py",
        "if not (again and leaves == outwards):",
        "if thing >= 0:",
    ),
    Plant(
        "glass without a shadow: photons stop at it",
        THIN_PHOTONS,
        _TRACING,
        "        if share > 0.0:\n",
        "        if share > 1.0:\n",
    ),
    Plant(
        "glass without a shadow: first hits of photons behind it counted twice",
        Test("tests/kernels/test_glass_shadows.py::test_photons_fly_on_through_a_pane"),
        _TRACING,
        "if (not straight or first_hits) and",
        "if (vertex > _VERTEX + 1 or first_hits) and",
    ),
    # Sky and camera.
    Plant("sky: no parallax", BACKGROUND, _SKY, "if sky.radius < math.inf:", "if sky.radius < 0.0:"),
    Plant("sky: left for right", BACKGROUND, _SKY, "u = math.atan2(n.x, n.y)", "u = math.atan2(-n.x, n.y)"),
    Plant("sky: a panorama read by equal areas", PANORAMA, _SKY, "    if sky.equal_area:", "    if sky.radius > 0.0:"),
    Plant(
        "camera: width for height",
        FLAT,
        _CAMERA,
        "mad(camera.down, y, ",
        "mad(camera.down, y * camera.height / camera.width, ",
    ),
    Plant(
        "camera: up not turned with the view",
        OUTSIDE,
        _MODEL,
        "return right, np.cross(right, forward), forward",
        "return right, np.asarray(self.up, np.float64), forward",
    ),
    Plant(
        "camera: rays through half of each pixel",
        OUTSIDE,
        _CAMERA,
        "        draw_2d(key, index, count, FILM, u, v, words)\n",
        "        draw_2d(key, index, count, FILM, u, v, words)\n"
        "        for k in range(count):\n            u[k], v[k] = 0.5 * u[k], 0.5 * v[k]\n",
    ),
    # Images on surfaces.
    Plant("image: upside down", IMAGES, _IMAGE, "_along(1.0 - v, ", "_along(v, "),
    Plant("image: half a texel aside", IMAGES, _IMAGE, "at = place * size - 0.5", "at = place * size"),
    Plant(
        "image: its border goes on where it repeats",
        IMAGES,
        _IMAGE,
        "place = place - np.floor(place) if repeats else",
        "place = min(max(place, 0.0), 1.0) if repeats else",
    ),
    Plant("image: the nearest texel", IMAGES, _IMAGE, "return low, high, at - below", "return low, high, 0.0"),
    Plant(
        "image: its mean in its place",
        IMAGES,
        _IMAGE,
        "[image.texels.ravel() for image in images]",
        "[(0.0 * image.texels + image.texels.mean(axis=(0, 1))).astype(np.float32).ravel() for image in images]",
    ),
    Plant(
        "image: weights of the corners exchanged",
        IMAGES,
        _IMAGE,
        "b0 * uv[face, 0, 0] + b1 * uv[face, 1, 0] + b2 * uv[face, 2, 0]",
        "b0 * uv[face, 0, 0] + b2 * uv[face, 1, 0] + b1 * uv[face, 2, 0]",
    ),
    Plant(
        "image: diffuse weight without (1 - g)",
        GLOSSY_IMAGES,
        "renderer/material.py",
        "scale(_color(materials, images, surface), 1.0 - _gloss(materials, images, surface))",
        "_color(materials, images, surface)",
    ),
    Plant(
        "image: the largest gloss everywhere",
        GRAINED,
        "renderer/material.py",
        "number_at(images, images.gloss[surface.object], surface.face, surface.b1, surface.b2)",
        "materials.specular[surface.object]",
    ),
    Plant(
        "image: the largest roughness everywhere",
        GRAINED,
        "renderer/material.py",
        "number_at(images, images.roughness[surface.object], surface.face, surface.b1, surface.b2)",
        "materials.alpha[surface.object]",
    ),
    Plant(
        "image: no photons where it is black",
        Test("tests/kernels/test_textures.py::test_photons_land_where_the_image_is_black_too"),
        _TRACING,
        "and holds_photons(scene, surface):",
        "and max_component(diffuse_weight(scene, surface)) > 0.0:",
    ),
    Plant(
        "image: sRGB read as linear",
        Test("tests/unit/test_textures.py::test_whole_numbers_are_srgb_unless_the_file_or_the_scene_says_otherwise"),
        "scenes/textures.py",
        'if encoding == "linear":',
        "if encoding:",
    ),
    Plant(
        "image: glTF's v taken for ours",
        Test("tests/unit/test_textures.py::test_one_quad_lies_alike_whatever_file_holds_it"),
        "scenes/meshes/glb.py",
        'return downwards(self.accessor(primitive["attributes"][name]))',
        'return self.accessor(primitive["attributes"][name])',
    ),
    Plant(
        "lamp's image: its brightest everywhere",
        SCREEN,
        "renderer/material.py",
        "color_at(images, emission[thing], face, b1, b2)",
        "vec3(materials.emission, thing)",
    ),
    Plant(
        "lamp's image: its brightest where it is drawn",
        SCREEN_DRAWN,
        "renderer/terms/background.py",
        "emission(scene, surface.face, surface.b1, surface.b2)",
        "column(scene.materials.emission.T, surface.object)",
    ),
    Plant(
        "lamp's image: the chance of a face forgotten",
        Test("tests/kernels/test_lamp_images.py::test_irradiance_is_that_of_quadrature"),
        _LIGHTS,
        "return last, its / total, min(rest / its, BELOW_ONE)",
        "return last, 1.0 / count, min(rest / its, BELOW_ONE)",
    ),
    Plant(
        "lamp's image: photons of uniform power",
        SCREEN_PHOTONS,
        _FACE,
        "    radiance = emission(scene, face, b1, b2)",
        "    radiance = emission(scene, face, 1.0 / 3.0, 1.0 / 3.0)",
    ),
    Plant(
        "lamp's image: a corner for the sampled point",
        SCREEN,
        "renderer/light_sampling.py",
        "emission(scene, entry(samples.target, i), samples.b1[i], samples.b2[i])",
        "emission(scene, entry(samples.target, i), samples.b2[i], samples.b1[i])",
    ),
    Plant(
        "lamp's image: its scale forgotten",
        Test("tests/unit/test_textures.py::test_an_emission_may_be_an_image"),
        "scenes/load.py",
        "texels = texels * np.float64(self.scale)",
        "texels = texels * 1.0",
    ),
    Plant(
        "lamp's image: no photons where none was looked for",
        Test("tests/unit/test_textures.py::test_the_chances_of_a_lamp_are_above_0_wherever_it_may_shine"),
        _MODEL,
        "return 0.5 * (here / len(_MIDDLES) + self.emission.texels.mean(axis=0, dtype=np.float64).mean(axis=0))",
        "return here / len(_MIDDLES)",
    ),
    Plant(
        "glTF: sRGB read as linear",
        Test("tests/unit/test_textures.py::test_a_scene_of_glb_has_its_images"),
        "scenes/exchange/from_gltf.py",
        '"sRGB" if encoded else "linear"',
        '"linear"',
    ),
    Plant(
        "glTF: the factor on an image forgotten",
        Test("tests/unit/test_textures.py::test_a_scene_of_glb_has_its_images"),
        "scenes/exchange/from_gltf.py",
        'values = texels * surface.get("baseColorFactor", (1.0, 1.0, 1.0, 1.0))[:3] * tint',
        "values = texels * tint",
    ),
    Plant(
        "glTF: roughness taken for alpha",
        Test("tests/unit/test_textures.py::test_roughness_of_glb_is_its_green_squared"),
        "scenes/exchange/from_gltf.py",
        "np.clip(rough**2, MIRROR, 1.5)",
        "np.clip(rough, MIRROR, 1.5)",
    ),
    Plant(
        "keys: blind to texels",
        Test("tests/unit/test_textures.py::test_keys_see_texels_and_places"),
        "scenes/textures.py",
        "repr(self.texels.shape).encode() + self.texels.data",
        "repr(self.texels.shape).encode()",
    ),
    # Geometry, and how a scene is read.
    Plant(
        "tree: boxes up to the faces' middles",
        MESH,
        "renderer/geometry/bvh.py",
        "highs = np.ascontiguousarray(corners.max(axis=1))",
        "highs = np.ascontiguousarray(corners.mean(axis=1))",
    ),
    Plant(
        "smooth normals: corners shared by no weight",
        SMOOTH,
        _MODEL,
        "np.add.at(normals, places[faces[:, corner]], weighted)",
        "normals[places[faces[:, corner]]] = weighted",
    ),
    Plant(
        "scene file: rotations about the turned axes",
        OUTSIDE,
        "scenes/load.py",
        'euler_matrix(about_x, about_y, about_z, "sxyz")',
        'euler_matrix(about_x, about_y, about_z, "rxyz")',
    ),
    # Choices of the paper.
    Plant(
        "paper's shadow: a corner for the light's centre",
        SHADOWED,
        _MODEL,
        "points + [(thing.mesh.centroid(), i)",
        "points + [(tuple(thing.mesh.vertices[0].tolist()), i)",
    ),
    Plant(
        "paper's E read as E / pi", BRIGHT, _MODEL, 'return math.pi if self.irradiance == "E" else 1.0', "return 1.0"
    ),
)
