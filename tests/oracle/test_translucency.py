"""Translucency in Mitsuba: its own plugins, chi², closed forms, and the renderer against the references, row by row.

Rationale: the references' BSDF is a plugin of ours. A blend of Mitsuba's `diffuse` and the transmitted part of
`principledthin`, which is Lambert's, means the same and shares no code with it.
"""

import importlib
import math
from typing import Any

import attrs
import numpy as np
import pytest

from termwise import reference
from termwise.reference.backend import active, import_mitsuba
from termwise.renderer import Engine, find
from termwise.scenes import limits
from termwise.scenes.analytic import plate, unit_sphere
from termwise.scenes.limits import Kernel, Limit
from termwise.scenes.load import load
from termwise.scenes.model import Ambient, Camera, Material, Photons, PointLight, Scene, Sky

mi: Any = import_mitsuba()
dr: Any = importlib.import_module("drjit")
from termwise.reference import bsdf  # noqa: E402  subclasses Mitsuba's plugins

pytestmark = pytest.mark.skipif(active().variant == "scalar_rgb", reason="needs a vectorised variant")

bsdf.register()
COLOR = (0.2, 0.5, 0.8)
SHARES = (0.0, 0.3, 1.0)


def ours(share: float) -> Any:
    color = {"type": "rgb", "value": list(COLOR)}
    return mi.load_dict({"type": "translucent", "reflectance": color, "share": share})


def theirs(share: float) -> Any:
    color = {"type": "rgb", "value": list(COLOR)}
    stays = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": color}}
    crosses = {"type": "principledthin", "base_color": color, "diff_trans": 2.0}
    return mi.load_dict({"type": "blendbsdf", "weight": share, "stays": stays, "crosses": crosses})


def unit_vectors(count: int, seed: int) -> np.ndarray:
    found = np.random.default_rng(seed).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def seen_along(views: np.ndarray) -> Any:
    si = dr.zeros(mi.SurfaceInteraction3f, len(views))
    si.wi = mi.Vector3f(views.T)
    return si


@pytest.mark.parametrize("share", SHARES)
def test_it_is_a_blend_of_mitsubas_own(share: float):
    """Value and density at pairs of directions on all sides; the share of either side."""
    si, ways = seen_along(unit_vectors(500, 1)), mi.Vector3f(unit_vectors(500, 2).T)
    context = mi.BSDFContext()
    (value, density), (right, right_density) = (
        each.eval_pdf(context, si, ways) for each in (ours(share), theirs(share))
    )
    np.testing.assert_allclose(np.array(value), np.array(right), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(np.array(density), np.array(right_density), rtol=1e-5, atol=1e-7)
    for plugin in (ours(share), theirs(share)):
        found = np.array(bsdf.crossing_share(plugin, si, True))
        np.testing.assert_allclose(found, share, rtol=1e-5, atol=1e-6)
    whole = np.array(ours(share).eval_diffuse_reflectance(si, True)).reshape(3, -1)[:, 0]
    np.testing.assert_allclose(whole, COLOR, rtol=1e-6)


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("mu", [0.9, -0.3])
def test_samples_follow_the_density(share: float, mu: float):
    """Chi² over the whole sphere; of 1 - s in the place of s it is rejected. The weight is w."""
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    def test(of: float, against: float) -> bool:
        view = mi.Vector3f(math.sqrt(1.0 - mu * mu), 0.0, mu)
        told = '<rgb name="reflectance" value="1"/><float name="share" value="{}"/>'
        sample, _ = BSDFAdapter("translucent", told.format(of), wi=view)
        _, density = BSDFAdapter("translucent", told.format(against), wi=view)
        domain = SphericalDomain()
        chi2 = ChiSquareTest(domain, sample, density, sample_dim=3, sample_count=2**18, res=51, ires=16, seed=5)
        return chi2.run(significance_level=0.001, test_count=6, quiet=True)

    assert test(share, share)
    assert not test(share, 0.7 if share == 0.3 else 1.0 - share)
    points = mi.PCG32(size=1000, initstate=1)
    numbers = mi.Point2f(points.next_float32(), points.next_float32())
    si = seen_along(np.tile([0.0, math.sqrt(1.0 - mu * mu), mu], (1000, 1)))
    sample, weight = ours(share).sample(mi.BSDFContext(), si, points.next_float32(), numbers)
    np.testing.assert_allclose(np.array(weight) + np.zeros((3, 1000)), np.tile(COLOR, (1000, 1)).T, rtol=1e-6)
    value = np.array(ours(share).eval(mi.BSDFContext(), si, sample.wo))
    np.testing.assert_allclose(value, np.array(weight) * np.array(sample.pdf), rtol=1e-5)


def lantern(share: float, rho: float, *, outside: bool) -> Scene:
    """A closed sphere of paper around a point light."""
    scene = unit_sphere(albedo=rho, intensity=math.pi, subdivisions=4)
    walls = attrs.evolve(scene.objects[0], material=Material((rho, rho, rho), translucency=share))
    scene = attrs.evolve(scene, objects=(walls,), resolution=(8, 8))
    return attrs.evolve(scene, camera=Camera((0.0, -4.0, 0.0), (0.0, 0.0, 0.0), fov=8.0)) if outside else scene


@pytest.mark.parametrize("by_second", [False, True])
@pytest.mark.parametrize("outside", [False, True])
def test_a_lantern(outside: bool, by_second: bool):
    """`E = I / (1 - rho (1 - s))` within; from there `rho (1 - s) E / pi` is seen, `rho s E / pi` from outside."""
    rho, share = 0.8, 0.25
    scene = lantern(share, rho, outside=outside)
    limit = Limit("direct", scope="all")
    assert reference.has_second(scene, limit)
    (found,) = reference.replicate_parts(scene, limit, spp=2**13, seed=1, by_second=by_second).values()
    part = share if outside else 1.0 - share
    assert found.mean(dtype=np.float64) == pytest.approx(rho * part / (1.0 - rho * (1.0 - share)), rel=0.01)


def test_a_white_sheet_in_a_furnace():
    """It is invisible: ambient light by both integrators, and full transport under a white sky."""
    sheet = plate("sheet", (-3.0, -3.1, 0.0), (6.0, 0.0, 0.0), (0.0, 6.2, 0.0), Material((1.0,) * 3, translucency=0.5))
    camera = Camera((0.3, -4.0, 3.0), (0.3, 0.2, 0.0), fov=20.0)
    scene = Scene("furnace", camera, (sheet,), ambient=Ambient((1.0,) * 3), sky=Sky((1.0,) * 3), resolution=(4, 4))
    assert reference.replicate(scene, Limit("ambient"), spp=16, seed=1).mean() == pytest.approx(1.0, abs=1e-5)
    found = reference.replicate(scene, limits.physical("ambient"), spp=2**14, seed=1)
    assert found.mean() == pytest.approx(1.0, abs=5e-3)
    (second,) = reference.replicate_parts(scene, Limit("ambient"), spp=256, seed=1, by_second=True).values()
    assert second.mean() == pytest.approx(1.0, abs=0.02)


# The renderer's rows of the library's scene.


def small_leaf() -> Scene:
    """By rays through the middle of pixels: a photon map would see few of others."""
    scene = load("leaf")
    camera = attrs.evolve(scene.camera, pixel="centre")
    return attrs.evolve(scene, camera=camera, resolution=(12, 12), photons=Photons(20_000, 0.4))


ROWS = {
    "ambient cosine": (Limit("ambient"), 64, 64),
    "direct next-event": (Limit("direct", scope="first-hit"), 64, 64),
    "direct path": (Limit("direct", scope="all"), 128, 128),
    "direct photon-map": (Limit("direct", scope="all", kernel=Kernel("simpson", radius=0.4)), 1, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS)
def test_a_row_is_its_reference(row: str):
    """The mean of each channel, of all and of the part behind which the lamp is; s for 1 - s is told apart there."""
    limit, samples, spp = ROWS[row]
    term, variant = row.split()
    scene = small_leaf()
    if limit.scope == "first-hit":
        scene = attrs.evolve(scene, scope="first-hit")
    with Engine(scene) as engine:
        mine = np.array(
            [[*engine.prefixes(find(term, variant), samples=samples, seed=1, replicate=k)][-1][1] for k in range(16)]
        )
    right = np.array([reference.replicate(scene, limit, spp=spp, seed=2, replicate=k) for k in range(16)])
    leaves = np.s_[:, 4:8, 2:6]
    for part in (np.s_[:], leaves):
        a, b = (images[part].mean(axis=(1, 2), dtype=np.float64) for images in (mine, right))
        error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / 16)
        assert (np.abs(a.mean(axis=0) - b.mean(axis=0)) < 4.5 * error).all()
        assert (error < 0.02 * b.mean(axis=0)).all()


def test_the_chain_has_both_sides():
    """A mirror that shows the far side of a lit sheet: `w s E / pi` of the sheet in Mitsuba's chain."""
    color = (0.8, 0.5, 0.2)
    sheet = plate("sheet", (-9.0, -9.1, 0.0), (18.0, 0.0, 0.0), (0.0, 18.2, 0.0), Material(color, translucency=0.25))
    white = (1.0, 1.0, 1.0)
    mirror = plate(
        "mirror", (-30.0, -31.0, -2.0), (60.0, 0.0, 0.0), (0.0, 62.0, 0.0), Material(white, 1.0, 1e-3, white)
    )
    camera = Camera((0.3, -6.0, -1.0), (0.3, -3.5, -2.0), fov=0.01)
    light = PointLight((0.5, 0.25, 1.5), (3.0, 2.0, 1.0))
    scene = Scene("chain", camera, (sheet, mirror), (light,), resolution=(2, 2), max_bounces=1, scope="first-hit")
    # The ray comes to z = 0 at the height that it goes down from, twice as deep: y = -6 + 2.5 (1 + 2).
    point = np.array([0.3, 1.5, 0.0])
    offset = np.array(light.position) - point
    e = offset[2] / np.linalg.norm(offset) ** 3 * np.array(light.intensity)
    found = reference.replicate(scene, Limit("specular", scope="first-hit"), spp=256, seed=1).mean(axis=(0, 1))
    np.testing.assert_allclose(found, 0.25 * np.array(color) * e / math.pi, rtol=0.01)
