"""Many objects: those of one look are one shape of Mitsuba's, and every answer is that of the objects.

Rationale: a shape costs milliseconds in every kernel that is traced, and a thousand lamps took a quarter of an hour.
"""

import attrs
import numpy as np
import pytest

from termwise import reference
from termwise.reference import translate
from termwise.reference.geometry import first_hits
from termwise.scenes.limits import Limit
from termwise.scenes.load import load
from termwise.scenes.model import Camera, Material, Mesh, Object, Scene

QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def plate(name: str, x: float, y: float, z: float, size: float, *, down: bool = False, **more) -> Object:
    corners = np.array([[0, 0, 0], [size, 0, 0], [size, size, 0], [0, size, 0]], float) + [x, y, z]
    return Object(name, Mesh.from_arrays(corners[::-1] if down else corners, QUAD), **more)


def scene(count: int = 3) -> Scene:
    """A floor, tiles of two colours and lamps of two radiances, in turn; tiles hide some of the floor and the lamps."""
    objects = [plate("floor", -1.0, -1.0, 0.0, 2.0)]
    for i in range(count):
        x, y = 0.4 * (i % 4) - 0.8, 0.4 * (i // 4 % 4) - 0.8
        light = (4.0, 2.0, 1.0) if i % 2 else (1.0, 1.0, 1.0)
        color = (0.7, 0.2, 0.2) if i % 2 else (0.2, 0.7, 0.2)
        objects += [
            plate(f"tile{i}", x, y, 0.2 + 0.004 * i, 0.25, material=Material(color)),
            plate(f"lamp{i}", x + 0.1, y, 1.0 + 0.004 * i, 0.15, down=i % 2 == 0, emission=light),
        ]
    camera = Camera((0.3, -1.2, 2.5), (0.0, 0.0, 0.0))
    return Scene("many", camera, tuple(objects), resolution=(8, 8), draw_lights=True)


def test_few_objects_stay_apart_and_many_are_one_of_each_look():
    """Faces and their order are kept; a scene whose rays pass their own object stays as it is."""
    few, many = scene(), scene(40)
    shapes, parts = translate.gathered(few)
    assert shapes == few.objects
    assert parts == [[[number, 2]] for number in range(7)]
    shapes, parts = translate.gathered(many)
    assert len(shapes) == 5
    assert sorted(number for shape in parts for number, _ in shape) == list(range(81))
    for shape, held in zip(shapes, parts, strict=True):
        corners = [many.objects[number].mesh.vertices[many.objects[number].mesh.faces] for number, _ in held]
        np.testing.assert_array_equal(shape.mesh.vertices[shape.mesh.faces], np.concatenate(corners))
        looks = {(many.objects[number].surface, many.objects[number].emission) for number, _ in held}
        assert looks == {(shape.surface, shape.emission)}
    assert len(translate.gathered(attrs.evolve(many, ignore="object"))[0]) == 81


@pytest.fixture
def both(monkeypatch):
    """Call something with shapes apart and gathered."""

    def call(function):
        results = []
        for many in (10**9, 0):
            monkeypatch.setattr(translate, "MANY", many)
            reference._loaded.clear()
            results.append(function())
        reference._loaded.clear()
        return results

    return call


def test_hits_are_those_of_the_objects(both):
    """Object and face of each hit, whether they are shapes or parts of one."""
    few = scene(8)
    film = np.stack(np.meshgrid(*2 * [(np.arange(24) + 0.5) / 24]), axis=-1).reshape(-1, 2)
    directions = few.camera.rays(film, aspect=1.0)
    origins = np.broadcast_to(few.camera.position, directions.shape)
    apart, gathered = both(lambda: first_hits(few, origins, directions))
    assert len(np.unique(apart.object)) > 8
    np.testing.assert_array_equal(gathered.object, apart.object)
    np.testing.assert_array_equal(gathered.face, apart.face)


def test_faces_of_photons_are_those_of_the_objects(both):
    """A photon counts on its own object alone: each face has its object and its albedo."""
    few = scene(4)

    def surfaces():
        loaded = reference.loaded(few)
        from termwise.reference.kernel_reference import surfaces_of

        found = surfaces_of(loaded.scenes["direct"], loaded.description["parts"])
        order = np.lexsort(found.faces.corners.reshape(-1, 9).T)
        return found.faces.object[order], found.albedo[order], found.faces.corners[order], found.first

    apart, gathered = both(surfaces)
    for one, other in zip(apart[:3], gathered[:3], strict=True):
        np.testing.assert_array_equal(one, other)
    assert (len(apart[3]), len(gathered[3])) == (9, 5)


LIMITS = {
    "direct": Limit("direct", scope="all"),
    "paper's shadows": Limit("direct", scope="first-hit", shadows="paper"),
    "ambient": Limit("ambient"),
    "background": Limit("background"),
}


@pytest.mark.parametrize("name", LIMITS)
def test_images_are_those_of_the_objects(name, both):
    """Means agree within their noise; where no light is sampled, but for rounding."""
    few = attrs.evolve(scene(4), resolution=(4, 4), ambient=load("two_cubes").ambient)
    apart, gathered = both(lambda: reference.render(few, LIMITS[name], spp=64, seed=3, replicates=6))
    assert apart.mean.any()
    if name in ("ambient", "background"):
        np.testing.assert_allclose(gathered.mean, apart.mean, rtol=1e-6)
    else:
        means = [each.images.mean(axis=(1, 2)) for each in (apart, gathered)]
        error = np.sqrt(sum(each.var(axis=0, ddof=1) / len(each) for each in means))
        assert (np.abs(means[0].mean(axis=0) - means[1].mean(axis=0)) < 5.0 * error + 1e-6).all()
