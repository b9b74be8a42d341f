"""Vectors and frames against NumPy.

Rationale: every direction passes through `frame`; a basis that is not orthonormal at n = -z, or at n.z = -0.0, bends
the light there and nowhere else.
"""

import numpy as np
import pytest

from termwise.renderer import vector
from termwise.renderer.vector import Vec3, frame, is_black, length, to_local, to_world

SPECIAL = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (1.0, 0.0, -0.0), (-1.0, 0.0, -0.0), (0.0, 1.0, 0.0)]
SPECIAL += [(0.0, -1.0, -0.0), (1e-9, 0.0, -1.0), (0.6, 0.0, -0.8)]


def unit_vectors(count: int) -> np.ndarray:
    n = np.random.default_rng(1).normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return np.concatenate([SPECIAL, n])


def test_frame_is_orthonormal_and_right_handed(compiled):
    """Special and random normals: the matrix of s, t, n times its transpose is I, and its determinant +1."""
    for n in unit_vectors(500 if compiled else 50):
        basis = np.array(frame(Vec3(*n.tolist())))
        assert np.abs(basis @ basis.T - np.eye(3)).max() < 4e-15, n
        assert np.linalg.det(basis) == pytest.approx(1.0, abs=4e-15)
        np.testing.assert_array_equal(basis[2], n)


def test_local_and_world_are_inverse(compiled):
    """A vector taken to local coordinates and back is itself; the normal's local coordinates are (0, 0, 1)."""
    rng = np.random.default_rng(2)
    for n in unit_vectors(100 if compiled else 20):
        basis = frame(Vec3(*n.tolist()))
        v = Vec3(*rng.normal(size=3).tolist())
        np.testing.assert_allclose(to_world(basis, to_local(basis, v)), v, atol=5e-15)
        np.testing.assert_allclose(to_local(basis, basis.n), (0.0, 0.0, 1.0), atol=5e-15)


def test_arithmetic_is_that_of_numpy():
    """Each operation on random vectors against NumPy's, to the bit or to an ulp where the order of sums differs."""
    rng = np.random.default_rng(3)
    for a, b in rng.normal(size=(20, 2, 3)):
        u, v, s = Vec3(*a.tolist()), Vec3(*b.tolist()), float(a[0] + 2.0)
        np.testing.assert_array_equal(vector.add(u, v), a + b)
        np.testing.assert_array_equal(vector.sub(u, v), a - b)
        np.testing.assert_array_equal(vector.mul(u, v), a * b)
        np.testing.assert_array_equal(vector.scale(u, s), a * s)
        np.testing.assert_array_equal(vector.negate(u), -a)
        np.testing.assert_allclose(vector.mad(u, s, v), a * s + b, rtol=1e-15, atol=1e-15)
        np.testing.assert_allclose(vector.cross(u, v), np.cross(a, b), rtol=1e-13, atol=1e-15)
        assert vector.dot(u, v) == pytest.approx(a @ b, rel=1e-13, abs=1e-15)
        assert length(u) == pytest.approx(np.linalg.norm(a), rel=1e-15)
        assert length(vector.normalize(u)) == pytest.approx(1.0, rel=1e-15)
        assert vector.max_component(u) == a.max()


def test_black_means_all_zero():
    """-0.0 is black too; a single non-zero channel, however small, is not."""
    assert is_black(Vec3(0.0, -0.0, 0.0))
    for channel in range(3):
        assert not is_black(Vec3(*np.eye(3)[channel] * 1e-300))
