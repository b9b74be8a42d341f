"""The library's numbers are what the scripts in `scenes/library/sources` derive from the cited data.

Rationale: a colour typed into a scene file outlives the table it came from. The scripts are run again here
and the conversions themselves are held against references that are not ours.
"""

import importlib
import tomllib

import numpy as np
import OpenEXR
import PIL.Image
import pytest
import trimesh

from termwise.scenes.load import LIBRARY, library, load
from termwise.scenes.meshes import read_mapped
from termwise.scenes.model import largest, least

DIGITS = 0.51e-4  # the scene files give four decimals


@pytest.fixture
def source(monkeypatch):
    """Import a script by name, as if run from its folder."""
    monkeypatch.syspath_prepend(str(LIBRARY / "sources"))
    return importlib.import_module


def objects(scene: str) -> dict[str, dict]:
    return {item["name"]: item for item in tomllib.loads((LIBRARY / f"{scene}.toml").read_text())["objects"]}


def test_steel_is_the_iron_table(source):
    steel = objects("two_cubes")["steel cube"]
    np.testing.assert_allclose(steel["f0"], source("steel").steel_f0(), rtol=0, atol=DIGITS)


def test_conversion_keeps_a_perfect_and_a_grey_reflector(source):
    """Under its own illuminant white is (1, 1, 1); 5e-4 covers the rounding of Rec. 709's white point."""
    linear_rec709 = source("rec709").linear_rec709
    np.testing.assert_allclose(linear_rec709([400, 700], [1.0, 1.0]), 1.0, rtol=5e-4)
    np.testing.assert_allclose(linear_rec709([400, 700], [0.2, 0.2]), 0.2, rtol=5e-4)


def test_fresnel_of_known_media(source):
    """Glass of index 1.5 reflects 4 %; a conductor with n -> 0 reflects everything."""
    reflectance = source("steel").normal_reflectance
    assert reflectance(np.array(1.5), np.array(0.0)) == pytest.approx(0.04)
    assert reflectance(np.array(0.0), np.array(3.0)) == pytest.approx(1.0)


WHITE = "floor", "ceiling", "back wall", "front wall", "short block", "tall block"


@pytest.mark.parametrize(
    ("name", "paint"), [*((name, "white") for name in WHITE), ("red wall", "red"), ("green wall", "green")]
)
def test_cornell_box_is_painted_as_measured(source, name, paint):
    color = objects("cornell_box")[name]["color"]
    np.testing.assert_allclose(color, source("cornell_box").paint(paint), rtol=0, atol=DIGITS)


@pytest.mark.parametrize("name", ["short block", "tall block"])
def test_blocks_stand_where_measured(source, name):
    block = objects("cornell_box")[name]
    center, side, turn = source("cornell_box").footprint(name)
    np.testing.assert_allclose(block["translation"][:2], center, atol=0.51e-3)
    np.testing.assert_allclose(block["size"][:2], side, atol=0.51e-3)
    assert block["rotation"][2] == pytest.approx(turn, abs=0.051)


def test_walls_close_the_box():
    """The six walls make one watertight surface that faces inwards, around camera, blocks and lamp."""
    scene = load("cornell_box")
    walls = [thing for thing in scene.objects if thing.name in {"floor", "ceiling"} or "wall" in thing.name]
    corners = np.concatenate([thing.mesh.vertices[thing.mesh.faces] for thing in walls]).reshape(-1, 3)
    room = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))  # merges equal corners
    assert room.is_watertight
    # Inward normals make the signed volume negative; vertices are rounded to float32.
    assert room.volume == pytest.approx(-5.56 * 8.592 * 5.488, rel=1e-6)
    inside = [scene.camera.position]
    inside += [vertex for thing in scene.objects if thing not in walls for vertex in thing.mesh.vertices]
    low, high = room.bounds
    assert (np.array(inside) > low).all()
    assert (np.array(inside) < high).all()


def test_the_two_boxes_differ_in_scope_alone():
    one, other = load("cornell_box"), load("cornell_box_unshadowed")
    assert (one.scope, other.scope) == ("first-hit", "all")
    without = ("name", "scope")
    assert one.digest(without=without) == other.digest(without=without)


def test_sky_texture_is_the_script_s(source):
    """Half precision: one unit in the last place, for what a platform's exp may round otherwise."""
    with OpenEXR.File(str(LIBRARY / "sky.exr")) as file:
        stored = file.channels()["RGB"].pixels
    assert stored.dtype == np.float16
    np.testing.assert_allclose(stored.astype(np.float64), source("sky").texture().astype(np.float64), rtol=2**-10)
    assert stored.min() > 0  # no colour outside Rec. 709 was met


def test_ambient_of_two_cubes_is_the_mean_of_its_sky(source):
    """By the script's integral, and by the texture's own rows: texels are equal in solid angle."""
    scene = load("two_cubes")
    np.testing.assert_allclose(scene.ambient.color, source("sky").mean_radiance(), rtol=0, atol=DIGITS)
    assert scene.sky.texture is not None
    upper = scene.sky.texture[: len(scene.sky.texture) // 2]
    cosine = 1 - (np.arange(len(upper)) + 0.5) / len(upper)
    mean = np.average(upper.mean(axis=1), axis=0, weights=cosine)
    np.testing.assert_allclose(mean, scene.ambient.color, rtol=2e-3)  # half precision, midpoint rule


def test_texels_lie_where_the_paper_looks_them_up(source):
    directions = source("sky").texel_directions((6, 8))
    x, y, z = np.moveaxis(directions, -1, 0)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1)
    np.testing.assert_allclose(8 * (np.arctan2(x, y) / (2 * np.pi) + 0.5), np.tile(np.arange(8) + 0.5, (6, 1)))
    np.testing.assert_allclose(6 * (0.5 - z / 2), np.tile(np.arange(6) + 0.5, (8, 1)).T)


def test_sky_model_agrees_with_the_cie_clear_sky(source):
    """Luminance relative to the zenith against another published sky, CIE S 011 type 12 (clear).

    Two fits to different skies: they agree within 30 % at each point more than 20 degrees from the sun and
    6 degrees above the horizon, and within 10 % in the light that reaches the ground.
    """
    sky = source("sky")
    sun = np.array(sky.SUN)
    assert np.linalg.norm(sun) == pytest.approx(1)
    theta_sun = np.arccos(sun[2])
    upper = sky.texel_directions((256, 256))[:128].reshape(-1, 3)
    gamma = np.arccos(np.clip(upper @ sun, -1, 1))

    def indicatrix(angle):
        return 1 + 10 * (np.exp(-3 * angle) - np.exp(-3 * np.pi / 2)) + 0.45 * np.cos(angle) ** 2

    def gradation(cosine):
        return 1 - np.exp(-0.32 / cosine)

    cie = indicatrix(gamma) * gradation(upper[:, 2]) / (indicatrix(theta_sun) * gradation(1.0))
    ours = sky.sky_yxy(upper, sun, sky.TURBIDITY)[:, 0] / sky.zenith("Y", sky.TURBIDITY, theta_sun)
    compared = (gamma > np.radians(20)) & (upper[:, 2] > 0.1)
    np.testing.assert_allclose(ours[compared] / cie[compared], 1, atol=0.3)
    assert ours @ upper[:, 2] == pytest.approx(cie @ upper[:, 2], rel=0.1)


def test_the_checker_is_the_script_s(source):
    (ground,) = [thing for thing in load("glass").objects if thing.name == "ground"]
    made = source("checker").texels()
    (texture,) = ground.material.textures.values()
    np.testing.assert_array_equal(np.array(PIL.Image.open(LIBRARY / "checker.png"))[..., 0], made)
    dark, light = np.unique(texture.texels)
    assert (dark, light) == pytest.approx((0.0648, 0.6724), abs=5e-4)
    assert (texture.texels[..., 0] == light).sum() == made.size / 2


def test_the_stone_and_its_images_are_made_by_their_script(source):
    """Rounded to float32 and to whole numbers; no face of the stone lies across the seam of its image."""
    wild = source("wild")
    vertices, faces, uv = read_mapped(LIBRARY / "meshes" / "stone.ply")
    assert uv is not None
    for kept, made in zip((vertices, faces, uv), wild.stone(), strict=True):
        np.testing.assert_allclose(kept, made, atol=1e-6)
    assert np.ptp(uv[..., 0], axis=1).max() < 0.5
    for name, made in wild.IMAGES.items():
        kept = np.asarray(PIL.Image.open(LIBRARY / "images" / name), int)
        assert np.abs(kept - made()).max() <= 1


@pytest.mark.parametrize("name", library())
def test_every_scene_has_light_and_moderate_gloss(name):
    """What the study needs of its library: a light, no near-mirror but of glass, and bodies clear of the ground."""
    scene = load(name)
    assert scene.has_lights
    glossy = [thing.material for thing in scene.objects if largest(thing.material.gloss) > 0]
    assert all(least(material.roughness) >= 0.2 for material in glossy if material.transparency == 0)
    assert any(largest(thing.material.gloss) > 0 for thing in scene.objects)
    bodies = [thing for thing in scene.objects if len(thing.mesh.faces) > 2]
    assert all(thing.mesh.vertices[:, 2].min() > 0.01 for thing in bodies)
