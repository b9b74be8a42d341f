"""The table of terms: what a key is made of, and that a term is a row and a file.

Rationale: a field that a key leaves out by mistake makes results of another scene come back, which no image shows. So
each field is added or changed in turn, and the keys of all terms on both sides are looked at.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

from termwise import reference
from termwise.reference import store
from termwise.renderer.terms import DEFAULTS, VARIANTS
from termwise.reports.jobs import cells
from termwise.scenes import reads, terms
from termwise.scenes.limits import Limit, correct, physical
from termwise.scenes.load import load
from termwise.scenes.model import (
    Ambient,
    DirectionalLight,
    Material,
    PointLight,
    Scene,
    SphereLight,
    SpotLight,
    SunLight,
)
from termwise.scenes.terms import TABLE, TERMS, total

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def scene() -> Scene:
    """With a thing of each class of the model."""
    lights = (
        PointLight((0.0, 0.0, 3.0), (1.0, 1.0, 1.0)),
        SpotLight((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
        DirectionalLight((0.0, 0.0, -1.0), (1.0, 1.0, 1.0)),
        SunLight((0.0, 0.0, -1.0), (1.0, 1.0, 1.0)),
        SphereLight((0.0, 0.0, 3.0), 0.5, (1.0, 1.0, 1.0)),
    )
    return attrs.evolve(load("two_cubes"), lights=lights, resolution=(4, 4), substitutions=("a point for a lamp",))


@pytest.fixture(autouse=True)
def no_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_variant", lambda: "any")


def keys(scene: Scene) -> dict[str, str]:
    """The key of each term on each side, of full transport, and of the scene as Mitsuba has it."""
    ours = {
        f"our {term}": cells.key(scene, VARIANTS[term][name], samples=4, seed=1, chain="path")
        for term, name in DEFAULTS.items()
    }
    limits = {term: correct(term, "all") for term in TERMS} | {"physical": physical("direct")}
    theirs = {f"Mitsuba's {name}": store.key(scene, limit, spp=4, seed=1) for name, limit in limits.items()}
    loaded = reads.digest(scene, without=(*reads.UNREAD, *reference.UNLOADED))
    return ours | theirs | {"loaded": loaded}


def changed(thing: Any, path: list[str], value: Any) -> Any:
    """A thing of the model with a value in place of what is at a path, in the first of several things."""
    step, *rest = path
    if not rest:
        return value(thing, step)
    inner = getattr(thing, step)
    if isinstance(inner, tuple):
        return attrs.evolve(thing, **{step: (changed(inner[0], rest, value), *inner[1:])})
    return attrs.evolve(thing, **{step: changed(inner, rest, value)})


def with_toy(thing: Any, toy: float) -> Any:
    """The thing as one of a class that has a field more."""
    kind = attrs.make_class(
        type(thing).__name__, {"toy": attrs.field(default=0.0)}, bases=(type(thing),), frozen=True, eq=False
    )
    values = {field.name: getattr(thing, field.name) for field in attrs.fields(type(thing))}
    return kind(**values, toy=toy)


@pytest.mark.parametrize(
    "path",
    ["", "camera", "objects", "objects.material", "objects.mesh", "lights", "ambient", "sky", "photons", "toggles"],
)  # fmt: skip
def test_a_field_that_no_term_names_is_in_every_key(scene: Scene, path: str):
    """A new field of any class of the model, before a row says who reads it."""

    def toyed(toy: float) -> Scene:
        steps = path.split(".")
        if not path:
            return with_toy(scene, toy)
        return changed(scene, [*steps, "toy"], lambda thing, _: with_toy(thing, toy))

    before, same, after = keys(toyed(0.0)), keys(toyed(0.0)), keys(toyed(1.0))
    assert before == same
    assert [name for name, key in after.items() if key == before[name]] == []


def test_a_field_that_a_term_names_is_in_its_key_alone(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    row = attrs.evolve(TABLE["ambient"], reads=(*TABLE["ambient"].reads, reads.read("objects.material.toy")))
    monkeypatch.setitem(TABLE, "ambient", row)
    before, after = (
        keys(changed(scene, ["objects", "material", "toy"], lambda thing, _, toy=toy: with_toy(thing, toy)))
        for toy in (0.0, 1.0)
    )
    assert {name for name, key in after.items() if key != before[name]} == {
        # Specular meets it at the vertices of a chain; what is loaded, and full transport, is of all terms.
        "our ambient", "our specular", "Mitsuba's ambient", "Mitsuba's specular", "Mitsuba's physical", "loaded",
    }  # fmt: skip


def test_all_names_in_the_table_are_fields(scene: Scene):
    """A misspelt one would be read by nobody."""
    fields = {path for path, _, _ in reads.fields_of(scene)}
    assert terms.named() | {*terms.PHOTONS, *reference.UNLOADED} <= fields
    limits = {field.name for field in attrs.fields(Limit)}
    assert {name for row in TABLE.values() for name in row.limit} <= limits - {"term", "factor", "transport"}


def other(value: Any) -> Any:
    """Another value of the type of a field, allowed wherever it is a share; black turns white, all else black."""
    match value:
        case bool():
            return not value
        case float():
            return 0.25 if value != 0.25 else 0.75
        case (float(), float(), float()):
            return (0.0, 0.0, 0.0) if any(value) else (1.0, 1.0, 1.0)
    raise TypeError(f"{value!r}: say here what else such a field may be")


SEEN = dict.fromkeys((each, field) for row in TABLE.values() for each in row.reads if each.of for field in each.fields)


@pytest.mark.parametrize(("each", "field"), SEEN, ids=[field for _, field in SEEN])
def test_what_a_term_sees_of_fields_depends_on_each(scene: Scene, each: reads.Read, field: str):
    """A field hidden behind an `of` that ignores it would be in no key. All objects are glossy and have a colour."""
    mixed = Material(color=(0.5, 0.5, 0.5), gloss=0.5)
    start = attrs.evolve(scene, objects=tuple(attrs.evolve(thing, material=mixed) for thing in scene.objects))
    after = changed(
        start, field.split("."), lambda thing, step: attrs.evolve(thing, **{step: other(getattr(thing, step))})
    )
    assert each.of is not None
    assert each.of(start) != each.of(after)


def test_what_is_in_every_key(scene: Scene, record_property):
    """What no term may leave out; a field that is new is there too, until a row names it, and the report lists it."""
    fields = dict.fromkeys(path for path, _, _ in reads.fields_of(scene))
    everywhere = [path for path in fields if path not in terms.named()]
    expected = [path for path in fields if path.startswith(("camera.", "objects.mesh."))]
    expected += ["lights.center", "lights.radius"]  # surfaces too
    assert {*expected, "resolution", "intersection"} <= {*everywhere}
    new = {*everywhere} - {*expected, "resolution", "intersection"}
    record_property("in every key", everywhere)
    print(f"in every key for no row names them: {', '.join(everywhere)}; of these new: {sorted(new) or 'none'}")


PAPER = {"shadows": "paper"}
FULL = {"photons.scattering": "full"}
GLASS = {"objects.material.transparency": 0.75}
THIN = GLASS | {"objects.material.occludes": False}
DRAWN = {"draw_lights": True}
# A change, the scene that it is made to, and the terms that it touches: on our side, and on Mitsuba's where that
# differs.
TOUCHED = [
    ("objects.material.roughness", 0.9, {}, "specular", None),
    ("objects.material.roughness", 0.9, FULL, "direct specular", None),
    ("objects.material.f0", (0.9, 0.9, 0.9), {}, "specular", None),
    ("objects.material.color", (0.1, 0.1, 0.1), {}, "ambient direct specular", None),
    ("objects.material.gloss", 0.9, {}, "ambient direct specular", None),
    ("objects.material.translucency", 0.5, {}, "ambient direct specular", None),
    ("objects.material.transparency", 0.5, {}, "ambient direct specular transmission", None),
    ("objects.material.transparency", 0.5, GLASS, "ambient direct specular transmission", None),
    ("objects.material.ior", 1.3, {}, "", None),
    ("objects.material.ior", 1.3, GLASS, "specular transmission", None),
    ("objects.material.ior", 1.3, GLASS | FULL, "direct specular transmission", None),
    ("objects.material.tint", (0.5, 0.5, 0.5), GLASS, "specular transmission", None),
    ("objects.material.tint", (0.5, 0.5, 0.5), THIN, "ambient direct specular transmission", None),
    ("objects.material.occludes", False, GLASS, "ambient direct specular transmission", None),
    ("objects.material.fresnel", "dielectric", {}, "specular", None),
    ("lights.intensity", (2.0, 2.0, 2.0), {}, "direct specular", None),
    ("lights.intensity", (2.0, 2.0, 2.0), GLASS, "direct specular transmission", None),
    ("lights.intensity", (2.0, 2.0, 2.0), DRAWN, "direct specular background", None),
    ("lights.position", (9.0, 2.0, 2.0), {}, "direct specular", None),
    ("lights.position", (9.0, 2.0, 2.0), PAPER, "ambient direct specular", "direct specular"),
    ("toggles.lighting", False, {}, "direct specular", None),
    ("toggles.lighting", False, DRAWN, "direct specular background", None),
    ("toggles.lighting", False, PAPER, "ambient direct specular", "direct specular"),
    ("toggles.ambient_occlusion", False, {}, "ambient specular", None),
    ("ambient.range", 0.5, {}, "ambient specular", None),
    ("ambient", Ambient(source="sky"), {}, "ambient specular", None),
    ("sky.radius", 50.0, {"ambient": Ambient(source="sky")}, "ambient specular background", None),
    ("sky.color", (0.5, 0.5, 0.5), {}, "specular background", None),
    ("photons.count", 7, {}, "direct specular", ""),
    ("photons.count", 7, {"scope": "first-hit"}, "", ""),
    ("scope", "first-hit", {}, "direct specular", ""),
    ("rings", 7, {}, "ambient specular", ""),
    ("max_bounces", 7, {}, "specular", None),
    ("irradiance", "E", {}, "direct specular", None),
    ("ignore", "object", {}, "ambient direct specular", None),
    ("intersection", "paper", {}, " ".join(TERMS), ""),
    ("name", "another", {}, "", None),
    ("exposure", 2.0, {}, "", None),
    ("objects.name", "another", {}, "", None),
]


@pytest.mark.parametrize("kind", [DirectionalLight, SunLight, SpotLight])
def test_each_field_of_a_light_touches_what_lights_touch(kind: type, scene: Scene):
    """And nothing else: direct, and specular through it."""
    (light,) = (each for each in scene.lights if type(each) is kind)
    for field in attrs.fields(kind):
        value = getattr(light, field.name)
        other = 5.0 if isinstance(value, float | None) else (0.5, 0.25, -2.0 if "direction" in field.name else 2.0)
        before, after = (
            keys(attrs.evolve(scene, lights=(each,))) for each in (light, attrs.evolve(light, **{field.name: other}))
        )
        touched = {name for name, key in after.items() if key != before[name]}
        assert {"our direct", "our specular", "Mitsuba's direct", "Mitsuba's specular"} <= touched, field.name
        assert not {"our ambient", "our background", "Mitsuba's ambient", "Mitsuba's background"} & touched, field.name


@pytest.mark.parametrize(("path", "value", "base", "ours", "theirs"), TOUCHED)
def test_keys_are_no_finer_than_the_images(path: str, value: Any, base: dict, ours: str, theirs: str | None):
    """Each field touches what it decides and nothing else, chains of specular with photon maps."""
    start = attrs.evolve(load("two_cubes"), lights=(PointLight((0.0, 0.0, 3.0), (1.0, 1.0, 1.0)),))

    def put(scene: Scene, path: str, value: Any) -> Scene:
        return changed(scene, path.split("."), lambda thing, step: attrs.evolve(thing, **{step: value}))

    for name, setting in base.items():
        start = put(start, name, setting)
    after = put(start, path, value)
    touched = {
        term
        for term, name in DEFAULTS.items()
        if len({cells.content(each, VARIANTS[term][name], chain="next-event") for each in (start, after)}) == 2
    }
    assert touched == set(ours.split())
    touched = {
        term
        for term in TERMS
        if len({store.key(each, correct(term, "all"), spp=4, seed=1) for each in (start, after)}) == 2
    }
    assert touched == set((ours if theirs is None else theirs).split())


def test_the_papers_shadow_makes_lights_decide_on_ambient_light(scene: Scene):
    """By the limit, whatever the scene says: a variant without the rule is compared with the one with it."""
    scene, moved = (attrs.evolve(scene, lights=(PointLight((x, 0.0, 3.0), (1.0, 1.0, 1.0)),)) for x in (0.0, 9.0))
    for limit, same in ((Limit("ambient"), True), (Limit("ambient", shadows="paper"), False)):
        assert (store.key(scene, limit, spp=4, seed=1) == store.key(moved, limit, spp=4, seed=1)) == same


def test_a_colour_of_what_lets_all_light_through_is_no_diffuse_part(scene: Scene):
    """And the reason names the factor that is 0, for color (1 - gloss) is not."""
    glass = Material((0.5, 0.5, 0.5), 0.5, transparency=1.0)
    clear = attrs.evolve(
        scene, objects=tuple(each if each.emits else attrs.evolve(each, material=glass) for each in scene.objects)
    )
    assert TABLE["direct"].absent(clear) == "no surface has color (1 - gloss) (1 - transparency) > 0"


def test_an_unknown_term_has_no_rule(scene: Scene):
    with pytest.raises(KeyError):
        terms.content(scene, "glow")
    with pytest.raises(KeyError):
        correct("glow", "all")


def test_the_sum_is_a_left_fold_in_the_order_of_the_table():
    a, b, c, d, *others = np.random.default_rng(1).normal(size=(len(TERMS), 1000))
    assert TERMS == ("ambient", "direct", "specular", "transmission", "background")
    whole = ((a + b) + c) + d
    for each in others:
        whole = whole + each
    assert total(a, b, c, d, *others).tobytes() == whole.tobytes()
    with pytest.raises(ValueError, match="total of 3 images: allowed is one of each of ambient, direct"):
        total(a, b, c)


ROW = """
    TermRow(
        "glow",
        weight=_diffuse,
        absent=lambda scene: first((scene.exposure < 1.0, "the exposure is below 1")),
        reads=(read("toggles.lighting"), _DIFFUSE),
    ),
"""


@pytest.mark.slow
def test_a_fifth_term_is_a_row_and_a_file(tmp_path: Path):
    """Glow, added to a copy of the sources: planned, rendered, measured and in the sum, with keys of its own."""
    for package in ("renderer", "scenes", "reports", "reference"):
        shutil.copytree(
            PROJECT / package, tmp_path / "termwise" / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    shutil.copy(PROJECT / "termwise" / "__init__.py", tmp_path / "termwise")
    background = (PROJECT / "renderer" / "terms" / "background.py").read_text("utf-8")
    ours = background.replace('term="background"', 'term="glow"').replace('Limit("background")', 'Limit("glow")')
    (tmp_path / "termwise" / "renderer" / "terms" / "glow.py").write_text(ours, "utf-8")
    table = tmp_path / "termwise" / "scenes" / "terms.py"
    text = table.read_text("utf-8")
    assert text.count("    )\n}\nTERMS") == 1
    table.write_text(text.replace("    )\n}\nTERMS", f"{ROW}    )\n}}\nTERMS"), "utf-8")
    code = """
import attrs
from termwise import renderer
from termwise.renderer.plan import plan, skipped
from termwise.reports.jobs import cells
from termwise.reports.study.study import Study, Variants
from termwise.reports.study.subjects import subjects
from termwise.scenes.analytic import furnace
from termwise.scenes.limits import correct, physical
from termwise.scenes.terms import TERMS, total
from termwise import reference
scene = attrs.evolve(furnace(roughness=0.5, mu_o=0.7, gloss=0.5), resolution=(2, 2))
assert TERMS[-1] == "glow" and skipped(scene, "glow") is None
assert skipped(attrs.evolve(scene, exposure=0.5), "glow") == "the exposure is below 1"
images = {term: renderer.render(scene, term, samples=2).mean for term in TERMS}
assert images["glow"].shape == (2, 2, 3)
assert total(*images.values()).tobytes() == (sum(list(images.values())[1:], images["ambient"])).tobytes()
assert Variants().glow == ("seen",)
steps = plan(scene, {term: renderer.find(term) for term in TERMS})
works = [step.work for step in steps if step.term == "glow"]
assert works == ["kernel seen (seen)", "a pixel's further camera rays"], works
subject, = subjects(Study(scenes=("two_cubes",), resolution=(2, 2)), (scene,))
assert [variant.name for variant in subject.variants["glow"]] == ["seen"]
seen = renderer.find("glow")
dark = attrs.evolve(scene, toggles=attrs.evolve(scene.toggles, lighting=False))
deep = attrs.evolve(scene, max_bounces=7)
keys = [cells.content(each, seen, chain="path") for each in (scene, dark, deep)]
assert keys[0] != keys[1] and keys[0] == keys[2]
assert correct("glow", "all").scope is None
for limit in (correct("glow", "all"), physical("glow")):
    assert reference.shared(scene, limit) == correct("glow", "all")
    assert reference.parts(limit) == ("glow",)
    assert not reference.has_second(scene, limit)
"""
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
