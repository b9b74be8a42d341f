"""Images on surfaces: lookups against SciPy, and pictures of them against brute force.

Rationale: the oracle of a picture finds its hit points by itself (Möller and Trumbore 1997, all triangles, in numpy),
interpolates uv by the weights that it found, and looks the image up by SciPy. Nothing is random in such a picture:
the ambient light without occlusion, one ray in the middle of each pixel.
"""

import attrs
import numpy as np
import pytest
import trimesh
from scipy import ndimage

from termwise.renderer import Engine, find, render
from termwise.renderer.textures import color_at, from_scene, number_at
from termwise.scenes.analytic import plate
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, Photons, PointLight, Scene, Texture, Toggles

MODES = {"repeat": "grid-wrap", "clamp": "nearest"}


def texels(height: int, width: int, seed: int = 1, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.05, 0.95, (height, width, channels)).astype(np.float32)


def looked_up(image: Texture, uv: np.ndarray) -> np.ndarray:
    """By SciPy: (N, C) of places (N, 2)."""
    height, width, _ = image.texels.shape
    at = (1.0 - uv[:, 1]) * height - 0.5, uv[:, 0] * width - 0.5
    planes = np.moveaxis(image.texels.astype(np.float64), 2, 0)
    return np.stack([ndimage.map_coordinates(plane, at, order=1, mode=MODES[image.wrap]) for plane in planes], axis=1)


def square(image: Texture, uv: object = ((0, 0), (1, 0), (1, 1), (0, 1)), name: str = "square") -> Object:
    plain = plate(name, (-1.0, -1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), Material())
    mesh = Mesh.from_arrays(plain.mesh.vertices, plain.mesh.faces, uv=uv)
    return attrs.evolve(plain, mesh=mesh, material=Material(image))


def seen(*things: Object, size: tuple[int, int] = (8, 8), **changes: object) -> Scene:
    """The ambient light alone, without occlusion, at the middles of the pixels."""
    camera = Camera((0.2, -0.7, 2.6), (0.05, 0.0, 0.0), fov=50.0, pixel="centre")
    scene = Scene("seen", camera, things, ambient=Ambient((1.0, 0.5, 0.25)), resolution=size)
    return attrs.evolve(scene, **{"toggles": Toggles(ambient_occlusion=False)} | changes)


@pytest.mark.parametrize("wrap", MODES)
@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 4), (3, 1), (2, 2), (5, 7)])
def test_lookups_are_bilinear(wrap: str, height: int, width: int):
    """Far beyond the border too, and on it: the corners of a face lie anywhere, and texels at both ends meet."""
    image = Texture(texels(height, width), wrap)  # type: ignore[arg-type]
    grey = Texture(texels(width, height, 3, 1), wrap)  # type: ignore[arg-type]
    rng = np.random.default_rng(2)
    corners = rng.uniform(-3.0, 3.0, (40, 3, 2)).astype(np.float32)
    corners[:8] = rng.integers(-2, 3, (8, 3, 2))  # on the border of the image
    corners[8:16] = (rng.integers(-4, 5, (8, 3, 2)) + 0.5) / (width, height)  # on centres of texels
    faces = np.arange(120).reshape(-1, 3)
    mesh = Mesh.from_arrays(rng.normal(size=(120, 3)), faces, uv=corners)
    images = from_scene(seen(Object("shards", mesh, Material(image, grey))))
    assert images is not None
    weights = np.concatenate([np.eye(3), rng.dirichlet((1.0, 1.0, 1.0), 5)])
    for b in weights:
        found = np.array([color_at(images, 0, face, b[1], b[2]) for face in range(40)])
        places = np.einsum("k,fkc->fc", b, corners.astype(np.float64))
        np.testing.assert_allclose(found, looked_up(image, places), atol=1e-12)
        numbers = [number_at(images, images.gloss[0], face, b[1], b[2]) for face in range(40)]
        np.testing.assert_allclose(numbers, looked_up(grey, places)[:, 0], atol=1e-12)


def brute_force(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Hit of the ray through each pixel's middle: face, weights of its corners; (N,) and (N, 3)."""
    width, height = scene.resolution
    film = np.stack(np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height), axis=-1)
    ways = scene.camera.rays(film.reshape(-1, 2), aspect=scene.aspect)
    corners = np.concatenate([thing.mesh.vertices[thing.mesh.faces] for thing in scene.objects])
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(ways[:, None], second[None])
    scale = 1.0 / np.einsum("fx,nfx->nf", first, across)
    away = np.array(scene.camera.position) - corners[:, 0]
    b1 = np.einsum("fx,nfx->nf", away, across) * scale
    turned = np.cross(away, first)
    b2 = np.einsum("nx,fx->nf", ways, turned) * scale
    t = np.einsum("fx,fx->f", second, turned) * scale
    t = np.where((b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1) & (t > 0), t, np.inf)
    face = t.argmin(axis=1)
    rows = np.arange(len(ways))
    b1, b2 = b1[rows, face], b2[rows, face]
    return np.where(np.isfinite(t.min(axis=1)), face, -1), np.stack([1 - b1 - b2, b1, b2], axis=1)


@pytest.mark.rare
def test_pictures_are_those_of_brute_force():
    """A ball with places of each corner at random before a square: gloss 1/4 leaves 3/4, and as an image its rest."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.6)
    rng = np.random.default_rng(5)
    mesh = Mesh.from_arrays(
        ball.vertices + (0.2, 0.1, 0.7), ball.faces, uv=rng.uniform(-1.5, 1.5, (len(ball.faces), 3, 2))
    )
    on_ball, on_square = Texture(texels(6, 4, 7)), Texture(texels(3, 5, 8), "clamp")
    gloss = Texture(texels(4, 2, 9, 1))
    below = square(on_square, ((-0.3, 0), (1.2, -0.2), (1, 1), (0, 1.4)))
    below = attrs.evolve(below, material=Material(on_square, gloss))
    things = Object("ball", mesh, Material(on_ball, 0.25)), below
    scene = seen(*things, size=(24, 20))
    face, weights = brute_force(scene)
    corners = np.concatenate([np.asarray(thing.mesh.uv) for thing in scene.objects])[face]
    uv = np.einsum("nk,nkc->nc", weights, corners)
    of_ball = face < len(mesh.faces)
    on_below = (1.0 - looked_up(gloss, uv)) * looked_up(on_square, uv)
    expected = np.where(of_ball[:, None], 0.75 * looked_up(on_ball, uv), on_below)
    expected = np.where(face[:, None] < 0, 0.0, expected * scene.ambient.color)
    assert 0.1 < of_ball[face >= 0].mean() < 0.9
    found = render(scene, "ambient", samples=1).mean.reshape(-1, 3)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.plain
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_an_image_of_one_value_is_that_value(share: float):
    """All terms, whatever the uv, and what crosses; the reflections of one square in another meet it too."""
    value = np.array([0.25, 0.5, 0.75])
    image = Texture(np.tile(value, (3, 5, 1)))
    tilted = attrs.evolve(
        square(image, name="wall"),
        mesh=Mesh.from_arrays(
            [[-1, 1, 0.01], [1, 1, 0.01], [1, 1, 2], [-1, 1, 2]],
            [[0, 1, 2], [0, 2, 3]],
            uv=[[0, 0], [9, 0], [9, 9], [0, 9]],
        ),
    )
    gloss, roughness = (Texture(np.full((2, 2), each)) for each in (0.5, 0.4))
    steel = 0.04, 0.04, 0.04
    shown = Material(image, gloss, roughness, steel, share)
    things = [attrs.evolve(each, material=shown) for each in (square(image), tilted)]
    alpha = float(np.float32(0.4))
    plain = [attrs.evolve(each, material=Material((0.25, 0.5, 0.75), 0.5, alpha, steel, share)) for each in things]
    light = PointLight((0.3, -0.4, 1.5), (4.0, 3.0, 2.0))
    photons = Photons(count=500, radius=0.5)
    scenes = [
        seen(*objects, lights=(light,), photons=photons, toggles=Toggles(), max_bounces=2)
        for objects in (things, plain)
    ]
    for term, variant in (("ambient", "cosine"), ("direct", "path"), ("direct", "photon-map"), ("specular", "vndf")):
        images = [render(scene, term, variant=variant, samples=4, seed=3, chain="path").mean for scene in scenes]
        assert images[0].any()
        np.testing.assert_allclose(images[0], images[1], rtol=1e-6, atol=1e-7, err_msg=f"{term} {variant}")


@pytest.mark.parametrize("wrap", MODES)
def test_a_checker_of_two_by_two(wrap: str):
    """Its border at 0 is halfway between its texels where it repeats, and the texel itself where it is clamped."""
    dark, light = 0.2, 0.6
    image = Texture(np.float32([[[light] * 3, [dark] * 3], [[dark] * 3, [light] * 3]]), wrap)  # type: ignore[arg-type]
    images = from_scene(seen(square(image)))
    assert images is not None
    middle, corner = color_at(images, 0, 0, 0.5, 0.5).x, color_at(images, 0, 0, 0.0, 0.0).x  # (1, 1/2) and (0, 0)
    assert middle == pytest.approx(0.4, abs=1e-7)
    assert corner == pytest.approx(0.4 if wrap == "repeat" else dark, abs=1e-7)


@pytest.mark.plain
def test_photons_land_where_the_image_is_black_too():
    """A density counts those around a point: half of them would be missing beside a black half, and E with them."""
    half = np.zeros((1, 2, 3), np.float32)
    half[0, 1] = 0.5
    light = PointLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0))
    scene = seen(square(Texture(half, "clamp")), lights=(light,), toggles=Toggles())
    with Engine(attrs.evolve(scene, photons=Photons(count=3000, radius=0.5))) as engine:
        *_, (_, image, _) = engine.prefixes(find("direct", "photon-map"), samples=4, seed=1, replicate=0)
    whole = attrs.evolve(scene, objects=(square(Texture(np.full((1, 1, 3), 0.5, np.float32))),))
    with Engine(attrs.evolve(whole, photons=Photons(count=3000, radius=0.5))) as engine:
        *_, (_, plain, _) = engine.prefixes(find("direct", "photon-map"), samples=4, seed=1, replicate=0)
    face, weights = brute_force(scene)
    u = np.einsum("nk,nk->n", weights, scene.objects[0].mesh.uv[face, :, 0]).reshape(8, 8)  # type: ignore[index]
    share = np.clip(2.0 * u - 0.5, 0.0, 1.0)
    np.testing.assert_allclose(image[..., 0], share * plain[..., 0], rtol=1e-5, atol=1e-7)
