"""A saved scene is the scene: read back it has the same digest, and so the same image."""

import math

import attrs
import numpy as np
import pytest

from termwise.scenes import analytic
from termwise.scenes.load import library, load
from termwise.scenes.model import (
    Ambient,
    Camera,
    DirectionalLight,
    Material,
    Mesh,
    Object,
    Photons,
    PointLight,
    Scene,
    Sky,
    SphereLight,
    SpotLight,
    SunLight,
    Toggles,
)
from termwise.scenes.save import save


def everything() -> Scene:
    """A scene in which no field that a file can hold has its default."""
    ball = analytic.sphere_inside("ball", subdivisions=1, material=Material(translucency=0.125), smooth=True)
    corners = np.random.default_rng(1).normal(size=(5, 3))
    shard = Object("shard", Mesh.from_arrays(corners, [[0, 1, 2], [2, 3, 4]]), emission=(1.0, 0.1, 1 / 3))
    return Scene(
        "all",
        Camera((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (0.0, 1.0, 0.0), 33.3, 0.01, "corner"),
        (ball, shard),
        (
            PointLight((1.5, 2.5, 3.5), (9.0, 8.0, 7.0)),
            SpotLight((1.5, 2.5, 3.5), (0.5, 0.25, 0.125), (9.0, 8.0, 7.0), 33.0, 0.0),
        ),
        Ambient((0.3, 0.2, 0.1), 4.5),
        Sky(texture=np.random.default_rng(2).random((3, 5, 3), np.float32), radius=math.inf, projection="lat-long"),
        Photons(7, 0.125, 9, "uniform", 0.5, "full"),
        Toggles(False, False, False),
        (31, 17),
        2.5,
        5,
        8,
        "first-hit",
        "paper",
        "E",
        "object",
        "viewer",
        "paper",
        True,
    )


SCENES = {
    **{name: load(name) for name in library()},
    "everything": everything(),
    "lights of all kinds": attrs.evolve(
        load("two_cubes"),
        lights=(
            DirectionalLight((0.1, 0.2, -0.3), (3.0, 2.0, 1.0)),
            SunLight((0.1, 0.2, -0.3), (3.0, 2.0, 1.0)),
            SunLight((0.1, 0.2, -0.3), (3.0, 2.0, 1.0), 7.25),
            SpotLight((0.1, 0.2, 0.3), (3.0, 2.0, 1.0), (1.0, 1.0, 1.0)),
            SphereLight((0.1, 0.2, 7.0), 0.125, (3.0, 2.0, 1.0)),
        ),
    ),
    "glass": attrs.evolve(
        analytic.furnace(roughness=0.3, mu_o=0.5),
        objects=(
            analytic.plate("pane", (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), Material(transparency=0.5)),
            analytic.plate(
                "another",
                (0.0, 0.0, 1.0),
                (1.0, 0.0, 0.0),
                (0.0, 1.0, 0.0),
                Material(ior=1.25, tint=(0.5, 0.25, 1.0), transparency=1.0, fresnel="dielectric", occludes=False),
            ),
        ),
    ),
    "sky's light": attrs.evolve(load("two_cubes"), ambient=Ambient(source="sky", range=3.0)),
    "empty": Scene("empty", Camera((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
    "constant sky": analytic.furnace(roughness=0.3, mu_o=0.5),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_saved_scene_reads_back_as_itself(name, tmp_path):
    scene = SCENES[name]
    save(scene, tmp_path / "mine.toml")
    again = load(tmp_path / "mine.toml")
    assert again.digest(without=("name",)) == scene.digest(without=("name",))
    assert again.name == "mine"
    for ours, theirs in zip(again.objects, scene.objects, strict=True):
        assert ours.name == theirs.name


def test_a_moved_folder_still_loads(tmp_path):
    """Its paths are relative."""
    save(load("monkey"), tmp_path / "here" / "mine.toml")
    (tmp_path / "here").rename(tmp_path / "there")
    assert load(tmp_path / "there" / "mine.toml").digest() == load("monkey").digest()


def test_other_names_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"mine\.txt: allowed is a name that ends in \.toml"):
        save(load("monkey"), tmp_path / "mine.txt")
    assert not list(tmp_path.iterdir())


def test_rectangles_stay_rectangles(tmp_path):
    save(load("cornell_box"), tmp_path / "box.toml")
    text = (tmp_path / "box.toml").read_text()
    assert text.count('shape = "rectangle"') == 7
    assert len(list((tmp_path / "box.files").iterdir())) == 2


def test_a_scene_that_changed_shape_replaces_its_files(tmp_path):
    scene = load("monkey")
    save(scene, tmp_path / "mine.toml")
    monkey = scene.objects[1]
    mesh = monkey.mesh
    moved = attrs.evolve(monkey, mesh=Mesh.from_arrays(mesh.vertices + 0.5, mesh.faces))
    changed = attrs.evolve(scene, objects=(scene.objects[0], moved))
    save(changed, tmp_path / "mine.toml")
    assert load(tmp_path / "mine.toml").digest() == changed.digest()
