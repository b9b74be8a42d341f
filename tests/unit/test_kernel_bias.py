"""Classes of pixels under a photon kernel, on scenes where their areas are known in closed form."""

import numpy as np
import pytest
import trimesh

from termwise.renderer.arrays import from_scene
from termwise.renderer.triangles import Geometry
from termwise.reports.statistics.convergence import relative_error
from termwise.reports.study import kernel_bias
from termwise.scenes.analytic import plate
from termwise.scenes.model import Camera, Mesh, Object, Scene

FLOOR = plate("floor", (-1.0, -1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0))


def geometry_of(*objects: Object) -> Geometry:
    return from_scene(Scene("pieces", Camera((0.0, -3.0, 3.0), (0.0, 0.0, 0.0)), objects)).geometry


def box(name: str, *, size: float, centre: tuple[float, float, float]) -> Object:
    cube = trimesh.creation.box(extents=(size, size, size))
    return Object(name, Mesh.from_arrays(cube.vertices + centre, cube.faces))


def shares_of_floor(geometry: Geometry, radius: float, count: int) -> dict[str, float]:
    """Share of each class in count² points at the centres of the cells of a lattice over the floor."""
    at = (np.arange(count) + 0.5) * 2.0 / count - 1.0
    x, y = np.meshgrid(at, at)
    # The two triangles of a plate meet on its diagonal.
    faces = np.where(y > x, 1, 0)
    found = kernel_bias.classify(geometry, faces, np.stack([x, y, 0.0 * x], axis=-1), radius)
    return kernel_bias.pixels(found)


def test_a_floor_alone_ends_in_a_strip():
    """`(1 - r)²` of a 2 x 2 floor is interior; its diagonal, an edge of two triangles, is no end."""
    found = shares_of_floor(geometry_of(FLOOR), 0.2, 100)
    assert found == pytest.approx({"interior": 0.64, "boundary": 0.36, "leak": 0.0}, abs=1e-12)


def test_a_wall_across_the_floor_leaks_on_both_sides():
    """A strip 2 r wide of the floor leaks, its ends too; the rest is as before."""
    wall = plate("wall", (0.0, -1.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 1.0))
    found = shares_of_floor(geometry_of(FLOOR, wall), 0.2, 100)
    assert found == pytest.approx({"interior": 0.48, "boundary": 0.32, "leak": 0.2}, abs=1e-12)


def test_a_box_that_hovers_leaks_around_its_shadow():
    """A cube of side s, h above: `s² + 4 s rho + pi rho²` leaks, rho² = r² - h²; nothing from h > r on."""
    s, h, r = 0.5, 0.12, 0.2
    rho = np.sqrt(r * r - h * h)
    cube = box("cube", size=s, centre=(0.1, -0.05, h + s / 2))
    found = shares_of_floor(geometry_of(FLOOR, cube), r, 500)
    # Cells on the rim may fall on either side: its length times half a cell, far less by cancellation.
    leak = (s * s + 4 * s * rho + np.pi * rho * rho) / 4
    assert found["leak"] == pytest.approx(leak, rel=5e-3)
    assert found["boundary"] == pytest.approx(0.36, abs=1e-12)
    assert shares_of_floor(geometry_of(FLOOR, cube), 0.11, 50)["leak"] == 0.0


def test_an_object_never_leaks_into_itself():
    """A floor of one mesh with its wall bends at the corner: a strip r wide of boundary, and no leak."""
    vertices = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, 1, 1), (1, 1, 1)]
    corner = Object("corner", Mesh.from_arrays(vertices, [(0, 1, 2), (0, 2, 3), (3, 2, 5), (3, 5, 4)]))
    found = shares_of_floor(geometry_of(corner), 0.2, 100)
    assert found == pytest.approx({"interior": 0.64, "boundary": 0.36, "leak": 0.0}, abs=1e-12)


def test_a_ball_is_boundary_where_the_disc_is_wider_than_its_faces():
    ball = trimesh.creation.icosphere(subdivisions=2)
    geometry = geometry_of(Object("ball", Mesh.from_arrays(ball.vertices, ball.faces)))
    faces = np.arange(len(geometry.corners))
    points = geometry.corners.mean(axis=1)
    inscribed = np.array([trimesh.triangles.closest_point(geometry.corners, points)])
    np.testing.assert_allclose(inscribed[0], points, atol=1e-12)
    for radius, name in ((0.5, "boundary"), (0.01, "interior")):
        found = kernel_bias.classify(geometry, faces, points, radius)
        assert (found == kernel_bias.CLASSES.index(name)).all()


def test_what_sees_nothing_has_no_class():
    found = kernel_bias.classify(geometry_of(FLOOR), np.array([[-1, 0]]), np.zeros((1, 2, 3)), 0.1)
    assert found.tolist() == [[kernel_bias.UNSEEN, 0]]
    assert kernel_bias.pixels(found) == {"interior": 1.0, "boundary": 0.0, "leak": 0.0}
    assert kernel_bias.pixels(found[:, :1]) == {"interior": 0.0, "boundary": 0.0, "leak": 0.0}


def test_errors_of_the_classes_add_up_to_that_of_the_mean():
    """Boundary pixels 10 % too bright, leaking ones 20 % too dark: those times their light, with the jackknife."""
    rng = np.random.default_rng(41)
    classes = np.array([[0, 0, 1, 1], [0, 2, -1, 0]])
    truth = np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 0.0, 7.0]])[..., None] * np.ones(3)
    gain = np.array([1.0, 1.1, 0.8, 1.0])[classes][..., None]
    found = kernel_bias.shares(np.repeat((gain * truth)[None], 4, axis=0), np.repeat(truth[None], 4, axis=0), classes)
    values = {name: error.value for name, error in found.items()}
    expected = {"interior": 0.0, "boundary": 0.1 * 7 / 28, "leak": -0.2 * 6 / 28}
    assert values == pytest.approx(expected, abs=1e-12)
    ours, reference = (truth * each * rng.gamma(9.0, 1 / 9, (8, 2, 4, 1)) for each in (gain, 1.0))
    whole, parts = relative_error(ours, reference), kernel_bias.shares(ours, reference, classes)
    assert sum(each.value for each in parts.values()) == pytest.approx(whole.value, abs=1e-12)
    for side in range(2):
        summed = sum(each.leave_one_out[side] for each in parts.values())
        np.testing.assert_allclose(summed, whole.leave_one_out[side], atol=1e-12)
    luminance = np.array([0.2126, 0.7152, 0.0722])
    a, b = (each.mean(axis=(1, 2)) @ luminance for each in (ours, reference))
    assert whole.value == pytest.approx(a.mean() / b.mean() - 1, abs=1e-12)
    np.testing.assert_allclose(
        whole.leave_one_out[1], [a.mean() / np.delete(b, i).mean() - 1 for i in range(8)], atol=1e-12
    )


def test_the_label_is_the_largest_part_that_is_proven():
    noise = np.array([-1.0, 1.0, -1.0, 1.0])

    def part(value: float, error: float) -> kernel_bias.Estimate:
        return kernel_bias.Estimate(value, (value + error * noise,))

    parts = {"interior": part(0.02, 0.001), "boundary": part(-0.05, 0.001), "leak": part(0.2, 0.5)}
    assert kernel_bias.label(parts) == "boundary"
    assert kernel_bias.label({"leak": parts["leak"]}) == "none proven"
