"""Studies: presets load, and a file that is wrong is refused in one line that names file, field, value and allowed."""

import math
import tomllib
from pathlib import Path

import attrs
import pytest

from termwise.renderer.terms import DEFAULTS, VARIANTS
from termwise.reports.study import study, subjects
from termwise.scenes.load import library
from termwise.scenes.strict import FileError
from termwise.scenes.terms import TERMS

EXACT = """
[exact]
roughness = [0.3]
f0 = [0.04]
mu_o = [1.0]
gloss = [0.5]
bounces = 2
samples = 4
"""
SETTING = """
[[settings]]
name = "dark"
what = "The ambient light is out"
scenes = ["monkey"]
change = { ambient = { color = [0, 0, 0] }, max_bounces = 1 }
"""
VALID = 'scenes = ["monkey"]\nresolution = [8, 8]\n'


@pytest.mark.parametrize("name", study.studies())
def test_presets_measure_every_scene_with_enough_replicates(name: str):
    preset = study.load(name)
    # The paper's formulas say nothing of interpolated normals, and of no light but its points and faces.
    left_out = {"smooth_monkey"} if preset.folder == "variants" else set()
    left_out |= {"glass", "leaf", "lights", "wild"} if name != "full" else set()
    assert set(preset.scenes) == set(library()) - left_out
    assert preset.replicates >= 16
    assert preset.reference_replicates >= 16
    for term in TERMS:
        names = preset.variants_of(term)
        assert names[0] == DEFAULTS[term], "the first variant is the one in `total`"
        for name in names:
            samples = preset.samples_of(VARIANTS[term][name])
            assert samples & (samples - 1) == 0, "low-discrepancy points are well spread in powers of two"


@pytest.mark.parametrize("name", ["quick", "standard", "full"])
def test_no_default_row_is_judged_with_an_allowance(name: str):
    """Photons are judged by their kernel reference wherever the scene has them; normals are interpolated somewhere."""
    preset = study.load(name)
    by_kernel = 0
    every = list(subjects.subjects(preset, subjects.scenes_of(preset)))
    for subject in every:
        for term in TERMS:
            for variant in subject.variants[term]:
                limit = subjects.own_limit(preset, subject, variant)
                if variant.judged:
                    assert (limit.kernel is not None) == variant.kernel_based(subject.scene)
                    by_kernel += variant.kernel_based(subject.scene)
    assert by_kernel == 3 + sum(name in preset.scenes for name in ("glass", "leaf", "lights", "wild"))
    assert any(thing.mesh.normals is not None for subject in every for thing in subject.scene.objects)


def test_presets_grow():
    quick, standard, full = (study.load(name) for name in ("quick", "standard", "full"))
    for smaller, larger in ((quick, standard), (standard, full)):
        assert smaller.resolution < larger.resolution
        for term in TERMS:
            default = VARIANTS[term][DEFAULTS[term]]
            assert smaller.samples_of(default) <= larger.samples_of(default)


def test_a_study_by_path(tmp_path: Path):
    path = tmp_path / "mine.toml"
    path.write_text(VALID + 'seed = 7\n[samples]\nambient = 4\n"ambient.paper" = 2\n[variants]\ndirect = ["path"]\n')
    mine = study.load(path)
    assert (mine.scenes, mine.resolution, mine.seed) == (("monkey",), (8, 8), 7)
    assert mine.variants_of("ambient") == ("cosine", "paper")
    assert mine.variants_of("direct") == ("path",)
    assert [mine.samples_of(VARIANTS["ambient"][name]) for name in ("cosine", "paper")] == [4, 2]
    assert mine.samples_of(VARIANTS["direct"]["path"]) == study.DEFAULT_SAMPLES


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("scenes = [", ["is not TOML"]),
        ("resolution = [8, 8]", ["scenes: is missing"]),
        ('scenes = ["monkey"]', ["resolution: is missing"]),
        (VALID + 'folder = "here"', ["folder = 'here'", "'compare' or 'variants'"]),
        (VALID + EXACT.replace("[0.3]", "[-0.3]"), ["exact", "roughness = (-0.3,)", "[0.0001, 1.5]"]),
        (VALID + EXACT.replace("[1.0]", "[]"), ["exact", "mu_o = []", "at least one"]),
        (VALID + EXACT.replace("bounces = 2", "bounces = 0"), ["exact", "bounces = 0", "[1, 64]"]),
        (VALID + EXACT.replace("samples = 4", ""), ["exact.samples: is missing"]),
        (VALID + "radii = [1.0, 0.5]", ["radii = (1.0, 0.5)", "3 distinct factors"]),
        (VALID + "radii = [1.0, 0.5, 0.0]", ["radii = ", "(0, inf)"]),
        (VALID + SETTING + SETTING, ["settings", "'dark'", "twice"]),
        (VALID + SETTING.replace('"dark"', '"Dark side"'), ["settings", "Dark side"]),
        (VALID + SETTING + 'chain = "none"', ["settings[0].chain = 'none'", "'next-event' or 'path' or 'paper'"]),
        (VALID + SETTING + "other = 1", ["settings[0].other = 1", "unknown key"]),
        (VALID + SETTING.replace('["monkey"]', "[]"), ["settings", "scenes = []", "at least one"]),
        (VALID + "replicate = 4", ["replicate = 4", "unknown key", "replicates"]),
        (VALID + "replicates = 3", ["replicates = 3", "[4, 4096]"]),
        (VALID + "reference_replicates = 0", ["reference_replicates = 0", "[4, 4096]"]),
        (VALID + "reference_spp = 0", ["reference_spp = 0", "[1, "]),
        (VALID + "seed = -1", ["seed = -1", "[0, "]),
        (VALID + "seed = 1.0", ["seed = 1.0", "an integer"]),
        (VALID + "seed = true", ["seed = True", "an integer"]),
        (VALID + "photons = 0", ["photons = 0", "[1, "]),
        (VALID + "photons = -5", ["photons = -5", "[1, "]),
        (VALID + "photons_of = { monkey = 0 }", ["photons_of.monkey = 0", "[1, "]),
        (VALID + "photons_of = { mokney = 9 }", ["photons_of.mokney = 9", "allowed are", "monkey"]),
        (VALID + "[samples]\ndirect = 0", ["samples.direct = 0", "at least 1"]),
        (VALID + "[samples]\nglow = 4", ["samples.glow = 4", "unknown key", "ambient"]),
        (VALID + '[samples]\n"direct.glow" = 4', ["samples.direct.glow = 4", "unknown key", "direct.path"]),
        (VALID + '[samples]\ndirect = "16"', ["samples", "'16'", "an integer"]),
        (
            VALID + '[variants]\ndirect = ["photons"]',
            ["variants", "'photons'", "next-event, path, paper, paper-unweighted, photon-map, nearest"],
        ),
        (VALID + "[variants]\ndirect = []", ["variants", "direct = []", "next-event"]),
        (VALID + '[variants]\ndirect = ["path", "path"]', ["variants", "direct", "'path'", "twice"]),
        ("scenes = []\nresolution = [8, 8]", ["scenes = ", "at least one"]),
        ('scenes = ["monkey"]\nresolution = [8]', ["resolution = [8]", "a list of 2"]),
        ('scenes = ["monkey"]\nresolution = [8, 0]', ["resolution = (8, 0)", "[1, 65536]"]),
        ('scenes = ["monkey"]\nresolution = [8, nan]', ["resolution", "an integer"]),
    ],
)
def test_refused(text: str, named: list[str], tmp_path: Path):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(FileError) as caught:
        study.load(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for words in named:
        assert words in message


@pytest.mark.parametrize("name", ["nope", ".", "", "missing.toml", "quick.tom"])
def test_no_such_study(name: str):
    with pytest.raises(FileError, match="allowed are full, quick, standard|cannot be read"):
        study.load(name)


def test_a_scene_keeps_fewer_photons_than_the_study_grants():
    lavish = attrs.evolve(study.load("quick"), photons=10**9)
    (scene,) = subjects.scenes_of(lavish, ("monkey",))
    frugal = attrs.evolve(lavish, photons=10)
    assert scene.photons.count < 10**9
    assert subjects.scenes_of(frugal, ("monkey",))[0].photons.count == 10
    named = attrs.evolve(frugal, photons_of={"monkey": 10**8})
    assert subjects.scenes_of(named, ("monkey",))[0].photons.count == 10**8
    assert subjects.scenes_of(named, ("two_cubes",))[0].photons.count == 10


def test_the_same_scene_twice_is_refused():
    with pytest.raises(ValueError, match="'monkey' is named twice: allowed are distinct names"):
        subjects.scenes_of(study.load("quick"), ("monkey", "two_cubes", "monkey"))


def changed(text: str) -> list[subjects.Subject]:
    """The subjects of a study of the monkey with the setting above, `text` in place of its change."""
    setting = study.Setting(name="dark", what="", scenes=("monkey",), change=tomllib.loads(text))
    mine = study.Study(scenes=("monkey",), resolution=(8, 8), settings=(setting,))
    return list(subjects.subjects(mine, subjects.scenes_of(mine)))


def test_a_setting_changes_what_it_names_and_nothing_else():
    plain, dark = changed("ambient.color = [0, 0.5, 0]\nmax_bounces = 1")
    assert (plain.setting, plain.base, dark.base) == (None, None, plain.scene)
    assert dark.scene.name == "monkey.dark"
    undone = attrs.evolve(
        dark.scene,
        name="monkey",
        max_bounces=plain.scene.max_bounces,
        ambient=attrs.evolve(dark.scene.ambient, color=plain.scene.ambient.color),
    )
    assert undone.digest(without=()) == plain.scene.digest(without=())
    assert (dark.scene.ambient.color, dark.scene.max_bounces) == ((0.0, 0.5, 0.0), 1)
    assert [variant.name for variant in dark.variants["direct"]] == ["path"]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("glow = 1", "change: glow: unknown key: allowed are camera, "),
        ("camera.glow = 1", "change: glow: unknown key: allowed are position, "),
        ('camera = "here"', "change: camera = 'here': allowed is a table"),
        ("max_bounces = 1.5", "change: max_bounces = 1.5: allowed is an integer"),
        ("max_bounces = -1", "max_bounces = -1: allowed is a number in [0, 64]"),
        ('shadows = "none"', "change: shadows = 'none': allowed is 'physical' or 'paper'"),
        ("name = 'x'", "change: name: unknown key"),
        ("objects = []", "change: objects: unknown key"),
        ('normals = "face"\nphotons.survival = 2.0', "survival = 2.0: allowed is a number in (0, 1]"),
    ],
)
def test_a_setting_that_cannot_be_is_refused(text: str, named: str):
    with pytest.raises(ValueError, match="settings: dark: ") as caught:
        changed(text)
    assert named in str(caught.value)


def test_a_variant_of_another_scope_is_refused():
    """The box means first hits, `path` all bounces: the difference would be laid to the setting."""
    setting = study.Setting(name="dark", what="", scenes=("cornell_box",), change={"irradiance": "E"})
    mine = study.Study(scenes=("cornell_box",), resolution=(8, 8), settings=(setting,))
    with pytest.raises(ValueError, match=r"direct = 'path', of scope 'all': allowed .* 'first-hit' are next-event"):
        list(subjects.subjects(mine, subjects.scenes_of(mine)))


@pytest.mark.parametrize("name", study.studies())
def test_settings_of_presets_can_be(name: str):
    preset = study.load(name)
    changed = [each.setting for each in subjects.subjects(preset, subjects.scenes_of(preset)) if each.setting]
    assert len(changed) == sum(len(setting.scenes) for setting in preset.settings)


def test_settings_of_scenes_that_are_not_measured_are_left_out():
    variants = study.load("variants")
    names = [subject.scene.name for subject in subjects.subjects(variants, subjects.scenes_of(variants, ("monkey",)))]
    assert names[0] == "monkey"
    assert all(name.startswith("monkey.") for name in names[1:])
    assert "monkey.as-printed" in names


def test_the_chain_of_the_paper_s_terms_is_judged_against_its_twin():
    variants = study.load("variants")
    for subject in subjects.subjects(variants, subjects.scenes_of(variants, ("two_cubes",))):
        limit = subjects.own_limit(variants, subject, subject.variants["specular"][0])
        assert (limit.kernel is not None) == (subject.chain == "paper")
        assert limit.ambient == pytest.approx(math.pi if subject.chain == "paper" else 1.0)
