"""The state of a page: an input changes one thing, wrong values are refused by the model, undo and redo."""

import math
import shlex

import attrs
import numpy as np
import pytest

from termwise.renderer.auto import choice
from termwise.reports.live.inputs import groups
from termwise.reports.live.page import _variant, _verdict_table
from termwise.reports.live.state import History, State, command, get, invalidated, named, orbit, pan, put, zoom
from termwise.reports.live.truth import TruthRow, TruthView
from termwise.scenes.load import load
from termwise.scenes.save import save
from termwise.scenes.terms import TERMS

CUBES, BOX, MONKEY, LIGHTS = (State(load(name)) for name in ("two_cubes", "cornell_box", "monkey", "lights"))
PATHS = put(CUBES, ("variants", "direct"), "path")
GROUND = ("scene", "objects", 0, "material")

# What is changed, to what, and the terms that have to be rendered anew.
CHANGES = [
    (CUBES, ("scene", "exposure"), 2.0, ()),
    (CUBES, (*GROUND, "roughness"), 0.3, ("specular",)),
    (CUBES, (*GROUND, "f0", 1), 0.3, ("specular",)),
    (CUBES, (*GROUND, "gloss"), 0.3, ("ambient", "direct", "specular")),
    (CUBES, (*GROUND, "translucency"), 0.3, ("ambient", "direct", "specular")),
    (CUBES, (*GROUND, "transparency"), 0.3, ("ambient", "direct", "specular", "transmission")),
    (CUBES, (*GROUND, "ior"), 1.3, ()),
    (CUBES, (*GROUND, "fresnel"), "dielectric", ("specular",)),
    (CUBES, ("scene", "objects", 3, "emission", 0), 9.0, ("direct", "specular")),
    (CUBES, ("scene", "toggles", "ambient_occlusion"), False, ("ambient", "specular")),
    (CUBES, ("scene", "camera", "fov"), 50.0, TERMS),
    (CUBES, ("scene", "photons", "count"), 1000, ("direct", "specular")),
    (CUBES, ("scene", "photons", "survival"), 0.5, ("direct", "specular")),
    (PATHS, ("scene", "photons", "count"), 1000, ("specular",)),
    (CUBES, ("scene", "camera", "up", 0), 0.1, TERMS),
    (CUBES, ("scene", "max_bounces"), 1, ("specular",)),
    (CUBES, ("variants", "direct"), "path", ("direct",)),
    (PATHS, ("variants", "direct"), "next-event", ("direct",)),
    (CUBES, ("seed",), 5, TERMS),
    (CUBES, ("samples",), 5, ()),
    (BOX, ("scene", "photons", "count"), 1000, ()),
    (MONKEY, ("scene", "lights", 0, "position", 2), 3.0, ("direct", "specular")),
    (MONKEY, ("scene", "sky", "color", 0), 0.1, ("specular", "background")),
    (LIGHTS, ("scene", "lights", 1, "radius"), 0.2, TERMS),
    (LIGHTS, ("scene", "lights", 1, "radiance", 0), 9.0, ("direct", "specular")),
    (LIGHTS, ("scene", "lights", 2, "target", 0), 0.5, ("direct", "specular")),
    (LIGHTS, ("scene", "lights", 2, "beam"), None, ("direct", "specular")),
    (LIGHTS, ("scene", "lights", 3, "direction", 0), 0.1, ("direct", "specular")),
    (LIGHTS, ("scene", "lights", 4, "angle"), 20.0, ("direct", "specular")),
]  # fmt: skip


@pytest.mark.parametrize(("state", "path", "value", "terms"), CHANGES)
def test_a_change_touches_what_depends_on_it(state, path, value, terms):
    changed = put(state, path, value)
    assert get(changed, path) == value
    assert get(put(changed, path, get(state, path)), path) == get(state, path)
    touched = set(invalidated(state, changed))
    # Without lights drawn the sky of a scene still names them: a change more than needed is allowed there alone.
    assert touched - {"background"} == set(terms) - {"background"}
    assert touched >= set(terms)


def test_the_light_of_a_lamp_is_moved_and_scaled():
    position, size = ("scene", "objects", 3, "position"), ("scene", "objects", 3, "size")
    assert get(CUBES, size) == pytest.approx(2.0, rel=1e-6)
    smaller = put(CUBES, size, 0.5)
    assert get(smaller, size) == pytest.approx(0.5, rel=1e-5)
    np.testing.assert_allclose(get(smaller, position), get(CUBES, position), atol=1e-5)
    moved = put(smaller, (*position, 0), 7.0)
    np.testing.assert_allclose(get(moved, position), (7.0, *get(CUBES, position)[1:]), atol=1e-5)


def leaves(thing, path):
    """Paths of all values that a part of a scene consists of."""
    if attrs.has(type(thing)):
        for field in attrs.fields(type(thing)):
            yield from leaves(getattr(thing, field.name), (*path, field.name))
    elif isinstance(thing, tuple):
        for number, item in enumerate(thing):
            yield from leaves(item, (*path, number))
    else:
        yield path


@pytest.mark.parametrize("name", ["two_cubes", "cornell_box", "monkey", "lights"])
def test_every_field_of_a_scene_has_an_input(name):
    """But for names, meshes and textures, which a file gives, and what an emitter or another sky would not show."""
    state = State(load(name))
    paths = [each.path for _, inputs in groups(state) for each in inputs]
    assert len(set(paths)) == len(paths)
    for path in paths:
        get(state, path)
    textured = state.scene.sky.texture is not None
    for path in leaves(state.scene, ("scene",)):
        words = [step for step in path if isinstance(step, str)]
        emits = path[1] == "objects" and state.scene.objects[path[2]].emits
        given = words[-1] in ("name", "texture", "exposure") or "mesh" in words
        unseen = path[1] == "sky" and ("color" in words) == textured
        black = path[1] == "objects" and ("material" in words) == emits
        assert (path in paths) != (given or unseen or black), path


REFUSED = [
    (GROUND + ("gloss",), 1.5, r"ground: gloss = 1\.5: allowed is a number in \[0, 1\]"),
    (GROUND + ("gloss",), math.nan, r"ground: gloss = nan: allowed is"),
    (GROUND + ("gloss",), "shiny", r"gloss = 'shiny': allowed is a number"),
    (GROUND + ("fresnel",), "metal", r"ground: fresnel = 'metal': allowed is 'auto', 'schlick' or 'dielectric'"),
    (GROUND + ("gloss",), None, r"gloss = None: allowed is a number"),
    (GROUND + ("color", 0), -1.0, r"ground: color = \(-1\.0, "),
    (("scene", "camera", "fov"), 180.0, r"fov = 180\.0: allowed is a number in \(0, 180\)"),
    (("scene", "camera", "target"), (0.5, -6.4, 2.3), r"target = .*: allowed is a point other than position"),
    (("scene", "objects", 3, "size"), 0.0, r"lamp: size = 0\.0: allowed is a number in \(0, inf\)"),
    (("scene", "objects", 3, "position", 0), math.inf, r"lamp: position = .* allowed are finite numbers"),
    (("scene", "resolution", 0), 5000, r"resolution = \(5000, 128\): allowed is up to 1024 here"),
    (("scene", "resolution", 0), 0, r"resolution = \(0, 128\)"),
    (("scene", "max_bounces"), 1.5, r"max_bounces = 1\.5: allowed is an integer"),
    (("samples",), 0, r"samples = 0: allowed is a number in \[1, 1\.04858e\+06\]"),
    (("seed",), -1, r"seed = -1"),
    (("scene", "normals"), "face", r"normals = 'face': allowed is 'viewer' for specular vndf"),
    (("scene", "photons", "survival"), 0.0, r"survival = 0\.0: allowed is a number in \(0, 1\]"),
    (("scene", "photons", "survival"), "often", r"survival = 'often': allowed is a number"),
    (("scene", "camera", "up"), (0.0, 0.0, 0.0), r"up = .*: allowed is a vector not parallel"),
    (("scene", "toggles", "lighting"), 1, r"lighting = 1: allowed is true or false"),
    (("variants", "direct"), "magic", r"variant = 'magic' of direct: allowed are auto, next-event, path"),
]


@pytest.mark.parametrize(("path", "value", "message"), REFUSED)
def test_wrong_values_are_refused_in_the_models_words(path, value, message):
    with pytest.raises(ValueError, match=message):
        put(CUBES, path, value)


def test_the_page_names_what_auto_takes():
    assert _variant(CUBES, "direct") == "path, by auto"
    assert _variant(PATHS, "direct") == "path"
    assert _variant(BOX, "direct") == "next-event, by auto", "of first hits"
    assert _variant(CUBES, "ambient") == "cosine"


def test_no_input_waits_for_the_choice():
    """A state is made and compared without a path: the page answers while kernels compile."""
    before = choice.cache_info()
    assert invalidated(CUBES, put(CUBES, ("scene", "objects", 3, "emission", 0), 9.5)) == ("direct", "specular")
    assert choice.cache_info() == before


def test_undo_and_redo():
    history = History(CUBES)
    assert history.undo() is CUBES
    first, second, third = (put(CUBES, (*GROUND, "gloss"), gloss) for gloss in (0.1, 0.2, 0.3))
    history.push(first, "gloss", now=0.0)
    history.push(second, "gloss", now=0.5)  # the same drag
    history.push(third, "gloss", now=5.0)
    assert history.undo() is second
    assert history.undo() is CUBES
    assert not history.can_undo
    assert history.redo() is second
    history.push(third, "another", now=9.0)
    assert not history.can_redo
    assert history.redo() is third


def test_history_is_bounded():
    history = History(CUBES, depth=3)
    for number in range(10):
        history.push(attrs.evolve(CUBES, seed=number), number)
    assert [history.undo().seed for _ in range(4)] == [8, 7, 6, 6]


def test_the_camera_goes_round_its_target():
    camera = MONKEY.scene.camera
    distance = math.dist(camera.position, camera.target)
    turned = orbit(camera, 90.0, 0.0)
    assert math.dist(turned.position, turned.target) == pytest.approx(distance, rel=1e-5)
    assert turned.position[2] == pytest.approx(camera.position[2], abs=1e-5)
    before, after = (np.subtract(each.position, each.target)[:2] for each in (camera, turned))
    assert before @ after == pytest.approx(0.0, abs=1e-4)
    # What is seen follows the pointer to the right: the camera goes to its left.
    assert np.subtract(orbit(camera, 5.0, 0.0).position, camera.position) @ camera.frame()[0] < 0.0
    top = orbit(camera, 0.0, 500.0)
    assert top.position[2] - top.target[2] == pytest.approx(distance * math.sin(math.radians(89.0)), rel=1e-4)
    np.testing.assert_allclose(orbit(orbit(camera, 20.0, 5.0), -20.0, -5.0).position, camera.position, atol=1e-4)


def test_pan_and_zoom():
    camera = MONKEY.scene.camera
    near = zoom(camera, 0.5)
    assert near.target == camera.target
    assert math.dist(near.position, near.target) == pytest.approx(0.5 * math.dist(camera.position, camera.target))
    shifted = pan(camera, 0.1, 0.0)
    moved = np.subtract(shifted.target, camera.target)
    np.testing.assert_allclose(np.subtract(shifted.position, camera.position), moved, atol=1e-5)
    assert moved @ camera.frame()[2] == pytest.approx(0.0, abs=1e-5)


def test_the_command_names_what_differs(tmp_path):
    assert named(CUBES) == "two_cubes"
    assert command(CUBES, "two_cubes", 16) == "termwise render two_cubes --samples 16 --seed 0"
    changed = put(put(put(CUBES, ("scene", "resolution"), (64, 32)), ("variants", "direct"), "path"), ("seed",), 3)
    assert named(changed) == "two_cubes"
    words = shlex.split(command(changed, "two_cubes", 4))
    assert words[3:] == "--samples 4 --seed 3 --resolution 64 32 --variant direct=path".split()
    other = put(CUBES, (*GROUND, "gloss"), 0.3)
    assert named(other) is None
    file = tmp_path / "my scene.toml"
    save(other.scene, file)
    assert shlex.split(command(other, file, 1))[:3] == ["termwise", "render", str(file)]


def test_nothing_is_said_of_a_bias_before_the_first_look():
    """Fewer than four replicates have no interval: a dash, not `nan`."""
    row = TruthRow(
        "direct", "none before 4 replicates", math.nan, math.nan, math.nan, 0.12, "", np.zeros((1, 1, 3), np.uint8), 0.1
    )
    early = _verdict_table(TruthView(CUBES, 1, 16, 4, (row,)))
    assert "nan" not in early
    assert "<td>–</td><td>0.12</td>" in early
    later = _verdict_table(TruthView(CUBES, 4, 16, 4, (attrs.evolve(row, bias=0.0123, low=-0.01, high=0.034),)))
    assert "<td>+1.2\N{NARROW NO-BREAK SPACE}% [−1.0, +3.4]</td>" in later
