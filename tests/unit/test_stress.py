"""The stress lab: every row is measured once at a small size and passes, and a planted fault fails the row it hurts.

Rationale: a row that no fault can fail proves nothing, so for each group the fault that its rows are meant to see is
planted in what is judged, by a patch of the name that the group calls.
"""

import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from termwise.renderer import microfacet
from termwise.renderer.vector import Vec3, negate, scale
from termwise.reports import cli, stress
from termwise.reports.pages import stress as page
from termwise.reports.stress import (
    exact,
    garbage,
    intersection,
    lights,
    photons,
    radiance,
    rounding,
    shading,
    tracers,
    translucency,
    transmission,
)
from termwise.reports.stress.row import Row, measure
from termwise.scenes.analytic import plate
from termwise.scenes.load import load
from termwise.scenes.model import Camera, PointLight, Scene

SMALL = 128
UP, WHITE = Vec3(0.0, 0.0, 1.0), Vec3(1.0, 1.0, 1.0)
ROWS = [(group, row) for group, row in stress.rows(count=SMALL) if not row.timed]
# Groups that lean on the insides of the engine, or of photon maps.
SOON = "rounding", "photons"
CASES = [pytest.param(*case, marks=() if case[0] in SOON else pytest.mark.slow) for case in ROWS]


@pytest.fixture
def _fast(compiled):
    if not compiled:
        pytest.skip("as plain Python a row takes minutes")


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize(("group", "row"), CASES, ids=[f"{group}: {row.name}" for group, row in ROWS])
def test_row(group, row):
    case = measure(group, row, ("ours",))
    assert case["passed"], f"{case['figure']}: {case['ours']} > {case['limit']} {case['faults']}"


def test_names_are_unique():
    names = [(group, row.name) for group, row in stress.rows(count=SMALL)]
    assert len(names) == len(set(names))


def row(group: str, name: str) -> Row:
    return next(each for _, each in stress.rows((group,), SMALL) if each.name == name)


def broken(fault: str):
    """Our waves with a fault planted in what they find, or in what they are given."""

    def trace(corners, origins, directions, leaving):
        if fault == "float32":
            corners = np.array(corners, np.float32).astype(np.float64)
            origins = np.array(origins, np.float32).astype(np.float64)
        if fault == "no face ignored":
            leaving = np.full_like(leaving, -1)
            origins = origins - 1e-12 * directions
        found = tracers.waves(np.ascontiguousarray(corners), origins, directions, leaving)
        lost = np.zeros(len(origins), bool)
        if fault == "gaps along edges":
            lost = np.minimum(found.weights.min(axis=1), 1 - found.weights.sum(axis=1)) < 1e-12
        elif fault == "nothing nearer than 1e-5":
            lost = found.t < 1e-5
        found.t[lost], found.face[lost] = np.inf, -1
        return found

    return trace


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("float32", "scale 1e-6"),
        ("float32", "rotation 1"),
        ("float32", "offset 1000 sizes"),
        ("gaps along edges", "sphere: vertices, scale 1"),
        ("gaps along edges", "sphere: edge midpoints, scale 1"),
        ("gaps along edges", "along +x, zeros -0"),
        ("nothing nearer than 1e-5", "a wall at a gap of 1e-7"),
        ("nothing nearer than 1e-5", "scale 1e-6"),
        ("no face ignored", "spawned from a bumpy ball, scale 1"),
    ],
)
def test_a_planted_fault_fails_a_row_of_intersection(fault, name, monkeypatch):
    assert measure("intersection", row("intersection", name), ("ours",))["passed"]
    monkeypatch.setitem(tracers.OURS, "waves", broken(fault))
    assert not measure("intersection", row("intersection", name), ("ours",))["passed"]


def one_sided(factor: float):
    """The lobe, times a factor in one of both orders."""

    def lobe(wi, wo, alpha, f0):
        found = microfacet.eval_lobe(wi, wo, alpha, f0)
        return Vec3(*(each * (factor if wi.x > wo.x else 1.0) for each in found))

    return lobe


def fails(group: str, name: str) -> bool:
    return not measure(group, row(group, name), ("ours",))["passed"]


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize(
    ("name", "fault", "planted"),
    [
        ("G1, alpha 0.3", "smith_g1", lambda mu, alpha: float(np.float32(microfacet.smith_g1(mu, alpha)))),
        ("weights, alpha 0.3, cosine 1e-12", "sample_lobe", lambda *given: (Vec3(0.0, 0.0, np.nan), Vec3(1, 1, 1))),
        ("weights, alpha 0.3, cosine 1", "sample_lobe", lambda *given: (UP, Vec3(1.0 + 2.0**-52, 1, 1))),
        ("furnace, alpha 0.3, cosine 1", "sample_lobe", lambda *given: (UP, Vec3(0.8, 0.8, 0.8))),
        ("reciprocity, alpha 0.3, F0 1", "eval_lobe", lambda wi, wo, alpha, f0: Vec3(wo.z, wo.z, wo.z)),
        ("reciprocity, alpha 0.3, F0 1", "eval_lobe", one_sided(1.0 + 1e-14)),
        ("reciprocity, alpha 1.5, F0 0", "eval_lobe", one_sided(1.0 + 1e-12)),
        ("reciprocity, alpha 1.5, F0 0.04", "eval_lobe", one_sided(1.0 + 1e-14)),
        ("opposite directions", "eval_lobe", lambda wi, wo, alpha, f0: Vec3(1.0, 1.0, 1.0)),
        ("frame at -z, 1e-08 beside", "frame", lambda n: np.eye(3) * (1.0 + 1e-14)),
        ("visible slopes, alpha 0.5, cosine 0.1", "sample_visible_normal", lambda *given: UP),
    ],
)
def test_a_planted_fault_fails_a_row_of_shading(name, fault, planted, monkeypatch):
    monkeypatch.setattr(shading, fault, planted)
    assert fails("shading", name)


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("ambient, times 2^-100", lambda image: np.where(image < 1e-20, 0.0, image)),
        ("direct, times 2^100", lambda image: np.minimum(image, 1e20)),
        ("specular, times 2^1", lambda image: image + 1e-10),
        ("specular, times 2^-1050", lambda image: np.where(image < 2.0**-1022, 0.0, image)),
        ("ambient, times -0", lambda image: np.where(image == 0.0, np.nan, image)),
        ("a lamp of 1e+30 beside a sky of 1", lambda image: np.where(image < 1e-25 * image.max(), 0.0, image)),
    ],
)
def test_a_planted_fault_fails_a_row_of_radiance(name, fault, monkeypatch):
    sound = radiance._ours
    monkeypatch.setattr(radiance, "_ours", lambda scene, term: fault(sound(scene, term)))
    assert fails("radiance", name)


@pytest.mark.usefixtures("_fast")
def test_sums_in_float32_drift(monkeypatch):
    """They stand still at 2^24 times what is added, 1.7e6."""

    def add(out, scratch, times, value):
        out[:] = min(times, 2**24) * value

    monkeypatch.setattr(radiance, "_add", add)
    assert fails("radiance", "1e8 times 0.1")


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize("name", ["edge, radius 0.2", "corner, radius 0.2", "doubled walls 1e-06 apart"])
def test_a_kernel_that_knows_no_borders_fails_rows_of_photons(name, monkeypatch):
    """The paper's search divides by a whole disc and does not ask for the object."""
    monkeypatch.setattr(photons, "_ours", photons._paper)
    assert fails("photons", name)


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize("gap", ["0.01", "0.0001", "1e-06", "1e-12"])
def test_a_kernel_that_knows_no_sides_leaks_through_thin_walls(gap, monkeypatch):
    """All photons within a ball, over its disc: Jensen's estimate without his test of the normal."""

    def ball(scene, photons, surface):
        near = ((photons.position.T - np.array(surface.point)) ** 2).sum(axis=1) < photons.radius**2
        return photons.power[0, near].sum() / (np.pi * photons.radius**2)

    monkeypatch.setattr(photons, "_ours", ball)
    assert fails("photons", f"a wall {gap} thin")


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize("albedo", ["0.1", "0.5", "0.9"])
def test_a_lost_bounce_fails_the_flux_of_a_closed_box(albedo, monkeypatch):
    """Light after the first hit is lost, albedo of it all; the limit of 4096 photons is below a half of that."""
    emitted = photons._emitted

    def lost(scene, count, threads):
        found = emitted(scene, count, threads)
        return found._replace(power=found.power * (1.0 - float(albedo)))

    monkeypatch.setattr(photons, "_emitted", lost)
    name = f"flux in a closed box of albedo {albedo}"
    (one,) = (each for _, each in stress.rows(("photons",), 4096) if each.name == name)
    assert not measure("photons", one, ("ours",))["passed"]


@pytest.mark.rare
@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize(
    ("name", "planted"),
    [
        ("spot 89.999 to 90.0 degrees, scale 1", {"_irradiance": lambda _, found: found + 1e-9}),
        ("sun of 60 degrees overhead", {"_irradiance": lambda _, found: found / math.cos(math.radians(15.0)) ** 2}),
        ("directional light of cosine 1e-08", {"_irradiance": lambda _, found: found.astype(np.float32).astype(float)}),
        ("distant light, scale 1, offset 0", {"before": lambda given, found: Vec3(*given[0].center)}),
        ("rays to a sphere from 1000 radii, scale 1", {"distance_to": lambda _, found: float(np.float32(found))}),
    ],
)
def test_a_planted_fault_fails_a_row_of_lights(name, planted, monkeypatch):
    """Numbers of other formulas, or of fewer digits, in the place of ours."""
    for function, fault in planted.items():
        sound = getattr(lights, function)
        monkeypatch.setattr(lights, function, lambda *given, sound=sound, fault=fault: fault(given, sound(*given)))
    assert fails("lights", name)


@pytest.mark.rare
@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize(
    ("name", "function", "fault"),
    [
        ("sides, share 1.0000000000000001e-09", "side_of", lambda given, found: (given[1] < np.float32(0.0), found[1])),
        ("sides, share 0.5", "side_of", lambda given, found: (found[0], given[1])),
        ("sheet, scale 1, share 0.5, the side without the light", "_seen", lambda _, found: found * (1.0 - 1e-13)),
        ("furnace, scale 1, share 0.5", "_seen", lambda _, found: found * (1.0 - 2.0**-52)),
    ],
)
def test_a_planted_fault_fails_a_row_of_translucency(name, function, fault, monkeypatch):
    sound = getattr(translucency, function)
    monkeypatch.setattr(translucency, function, lambda *given, **more: fault(given, sound(*given, **more)))
    assert fails("translucency", name)


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize(
    ("name", "function", "fault"),
    [
        ("Fresnel, index 1.5", "fresnel_dielectric", lambda _, found: found * (1.0 - 1e-13)),
        ("Fresnel, index 1.0000001", "fresnel_dielectric", lambda _, found: found + 1e-14),
        ("Snell, index 10", "refract", lambda _, found: Vec3(found.x * (1.0 + 1e-13), found.y, found.z)),
        ("lobes, alpha 0.3, index 1.5", "sample_interface", lambda _, it: (it[0], scale(it[1], 2.3), it[2])),
        ("index 1, alpha 0.3", "sample_interface", lambda given, found: (negate(given[2]), WHITE, 1.0)),
        ("total reflection, index 1.5", "sample_interface", lambda given, found: (negate(given[2]), WHITE, 1.0)),
        (
            "energy, alpha 0.3, cosine 0.7, index 1.5",
            "sample_interface",
            lambda _, found: (found[0], found[1], found[2] ** 0.5),
        ),
        ("reciprocity across, alpha 0.3, index 1.5", "eval_transmission", lambda given, found: found * given[3] ** 2),
    ],
)
def test_a_planted_fault_fails_a_row_of_transmission(name, function, fault, monkeypatch):
    sound = getattr(transmission, function)
    monkeypatch.setattr(transmission, function, lambda *given: fault(given, sound(*given)))
    assert fails("transmission", name)


def grazing() -> Scene:
    """A plate under a point light 1e-4 above its plane and beside it: cosines of 1e-5 to 1e-4."""
    floor = plate("floor", (-1.0, -1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0))
    lamp = PointLight((-2.0, 0.3, 1e-4), (1.0, 1.0, 1.0))
    return rounding.moved(Scene("grazing", Camera((0.0, -3.0, 1.0), (0.0, 0.0, 0.0)), (floor,), lights=(lamp,)))


def lamp_of(scene: Scene) -> PointLight:
    (lamp,) = scene.lights
    assert isinstance(lamp, PointLight)
    return lamp


def irradiance(cosine):
    """E of points of the plate, by a formula of the cosine of a direction and a normal."""
    u, v = (each[..., None] for each in np.meshgrid(*2 * [(np.arange(32) + 0.5) / 32]))

    def image(scene: Scene) -> np.ndarray:
        a, b, _, c = scene.objects[0].mesh.vertices
        normal = np.cross(b - a, c - a)
        way = np.array(lamp_of(scene).position) - (a + u * (b - a) + v * (c - a))
        square = (way**2).sum(axis=-1, keepdims=True)
        cos = cosine(way / np.sqrt(square), normal / np.linalg.norm(normal))[..., None]
        return np.array(lamp_of(scene).intensity) * cos / square

    return image


def test_a_cancellation_at_grazing_angles_is_flagged():
    """sqrt(1 - sin²) loses 1 / cos² of the digits, the scalar product the 1 / cos that nature takes."""
    sound = rounding.spread(irradiance(lambda way, normal: np.abs(way @ normal)), grazing())
    assert rounding.quantile(sound, 0.5) < rounding.MEDIAN
    assert rounding.quantile(sound, 0.999) < rounding.HIGH
    assert np.nanmedian(sound.relative) > 1e4 * rounding.UNIT  # ill-conditioned, and not to blame

    def cancelling(way, normal):
        return np.sqrt(np.maximum(0.0, 1.0 - (np.cross(way, normal) ** 2).sum(axis=-1)))

    planted = rounding.spread(irradiance(cancelling), grazing())
    assert not planted.flips.all()
    assert rounding.quantile(planted, 0.5) > rounding.MEDIAN
    assert rounding.quantile(planted, 0.999) > rounding.HIGH


def test_a_sample_that_goes_another_way_is_counted_apart():
    """A step at a number that the perturbation crosses in one pixel."""
    edge = lamp_of(grazing()).intensity[0]

    def image(scene: Scene) -> np.ndarray:
        lit = np.full((2, 2, 3), lamp_of(scene).intensity[0])
        lit[0, 0] *= 1.0 if lit[0, 0, 0] > edge else 0.5
        return lit

    found = rounding.spread(image, grazing())
    assert found.flips.tolist() == [[True, False], [False, False]]
    assert np.isnan(found.growth[0, 0])
    assert 2 / 3 <= found.growth[1, 1] <= 4 / 3  # x (1 ± 2^-52) is rounded by at most a third of its change


@pytest.mark.usefixtures("_fast")
def test_samples_in_float32_fail_rows_of_rounding(monkeypatch):
    sound = rounding._image
    monkeypatch.setattr(rounding, "_image", lambda *given: sound(*given).astype(np.float32).astype(np.float64))
    rounding._spread.cache_clear()
    try:
        assert fails("rounding", "direct, median")
    finally:
        rounding._spread.cache_clear()


@pytest.mark.usefixtures("_fast")
@settings(deadline=None, max_examples=60, derandomize=True)
@given(data=st.data())
def test_any_value_in_any_field_is_refused_or_rendered(data):
    """Hypothesis in place of the rows' list of values: floats of all bits, integers, text, lists."""
    table, key = data.draw(st.sampled_from([(t, k) for t, keys in garbage.FIELDS.items() for k in keys]))
    number = st.floats().map(lambda x: "nan" if x != x else repr(x))
    value = data.draw(st.one_of(number, st.integers(-(2**70), 4096).map(str), st.sampled_from(garbage.VALUES)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(garbage.text(f"{table}.{key}", value), "utf-8")
        assert not garbage.faulty(lambda: garbage._small(load(path)))


@pytest.mark.usefixtures("_fast")
@settings(deadline=None, max_examples=60, derandomize=True)
@given(st.binary(max_size=300))
def test_any_bytes_are_refused_or_rendered(bytes_):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_bytes(bytes_)
        assert not garbage.faulty(lambda: load(path))


@pytest.mark.usefixtures("_fast")
@pytest.mark.parametrize("error", [KeyError("a crash"), ValueError("two\nlines"), ValueError("something is wrong")])
def test_a_planted_fault_fails_a_row_of_garbage(error, monkeypatch):
    def planted(path):
        raise error

    monkeypatch.setattr(garbage, "load", planted)
    assert fails("garbage", "camera.fov")


@pytest.mark.usefixtures("_fast")
def test_the_paper_fails_where_its_epsilons_predict():
    """Absolute epsilons of 1e-5: all is lost at scale 1e-6 and across a gap of 1e-7, nothing at scale 1e6."""
    names = ("scale 1e-6", "scale 1e6", "a wall at a gap of 1e-7", "a wall at a gap of 1e-3")
    small, large, near, far = (
        measure("intersection", row("intersection", name), ("paper",))["paper"] for name in names
    )
    assert (small, near, far) == (1.0, SMALL, 0)
    assert large < intersection.PRECISION


@pytest.mark.usefixtures("_fast")
def test_mitsuba_fails_where_its_offset_predicts():
    """It lifts rays by some 1e-4: a wall at 1e-3 is met, one at 1e-5 passed by."""
    near, far = (
        measure("intersection", row("intersection", f"a wall at a gap of {gap}"), ("mitsuba",))["mitsuba"]
        for gap in ("1e-5", "1e-3")
    )
    assert (near, far) == (SMALL, 0)


def test_rational_arithmetic_on_a_case_done_by_hand():
    """x + y + z = 1 is met from the origin along (1, 1, 2) at t = 1/4, inside; along (-1, 1, 1) beside the triangle."""
    corners = np.eye(3)[None]
    hit = exact.closest(corners, np.zeros(3), np.array([1.0, 1.0, 2.0]))
    assert (hit.t, hit.faces, hit.sure) == (0.25, (0,), True)
    assert exact.closest(corners, np.zeros(3), np.array([-1.0, 1.0, 1.0])).t is None
    # Through a vertex: met, and float64 may say otherwise.
    edge = exact.closest(corners, np.zeros(3), np.array([1.0, 0.0, 0.0]))
    assert (edge.t, edge.sure) == (1, False)


def test_what_is_no_number_fails():
    for value in (float("nan"), float("inf")):
        case = measure("g", Row("r", "a figure", 1.0, lambda value=value: value))
        assert (case["ours"], case["passed"]) == (None, False)
        assert "ours" in case["faults"]


def test_a_crash_fails_the_row_and_is_told():
    def crash() -> float:
        raise ZeroDivisionError("by nothing")

    case = measure("g", Row("r", "a figure", 1.0, lambda: 0.5, crash))
    assert case["passed"]
    assert (case["paper"], case["faults"]) == (None, {"paper": "ZeroDivisionError: by nothing"})
    assert not measure("g", Row("r", "a figure", 1.0, crash))["passed"]


def test_unknown_groups_and_rows_are_refused():
    with pytest.raises(ValueError, match=rf"group = 'x': allowed are {', '.join(stress.GROUPS)}$"):
        stress.measure(groups=("x",))
    with pytest.raises(ValueError, match="case = 'no such row'"):
        stress.measure(case="no such row")


def test_command_and_page(tmp_path, monkeypatch, capsys):
    """JSON as the interface has it; exit status 1 where a row fails; the page names what fails and how to repeat it."""
    rows = [
        Row("good & true", "a <count>", 0.0, lambda: 0.0, lambda: 3.0, lambda: 0.0),
        Row("bad", "a count", 0.0, lambda: 1.0),
    ]
    monkeypatch.setattr(intersection, "rows", lambda count: iter(rows))
    status = cli.measuring.stress(group=["intersection"], out=tmp_path, json_=True)
    found = json.loads(capsys.readouterr().out)
    assert status == 1
    assert found["failed"] == 1
    keys = ("name", "group", "ours", "paper", "mitsuba", "limit", "passed")
    assert [tuple(case[key] for key in keys) for case in found["cases"]] == [
        ("good & true", "intersection", 0.0, 3.0, 0.0, 0.0, True),
        ("bad", "intersection", 1.0, None, None, 0.0, False),
    ]
    text = (tmp_path / "stress" / "index.html").read_text("utf-8")
    assert "good &amp; true" in text
    assert "a &lt;count&gt;" in text
    assert "termwise stress --group intersection --case bad" in text
    assert cli.measuring.stress(group=["intersection"], case="good", out=tmp_path) == 0
    assert "0 failed" in capsys.readouterr().out
    with pytest.raises(ValueError, match="no such file"):
        page.write(tmp_path)
