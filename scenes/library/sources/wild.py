"""What `wild.toml` is made of: a mesh that looks scanned, and images, all from noise: writes the files beside it.

The stone is an icosphere whose points p lie at `r(p) p`, r being octaves of value noise; its images lie on it by
longitude and latitude, `u = atan2(y, x) / (2 pi) + 1/2, v = asin(z) / pi + 1/2`, over the seam at u > 1. They are whole
numbers of sRGB, and of the roughness alpha.
"""

from pathlib import Path

import numpy as np
import PIL.Image
import trimesh

LIBRARY = Path(__file__).parents[1]
SIZE = 128, 256  # rows and columns of the stone's images


def noise(points: np.ndarray, seed: int) -> np.ndarray:
    """Value noise (...,) in [-1, 1] at points (..., 3): smooth between the points of a lattice of 16³, periodic."""
    lattice = np.random.default_rng(seed).uniform(-1.0, 1.0, (16, 16, 16))
    low = np.floor(points).astype(np.int64)
    share = points - low
    share = share * share * (3.0 - 2.0 * share)
    value = np.zeros(points.shape[:-1])
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, share, 1.0 - share).prod(axis=-1)
        value += weight * lattice[tuple(np.moveaxis((low + corner) % 16, -1, 0))]
    return value


def octaves(points: np.ndarray, seed: int, count: int = 5, *, ridged: bool = False) -> np.ndarray:
    """Noise of doubled frequency and half the size, `count` times; `ridged`: with a crest wherever it is 0."""
    total = np.zeros(points.shape[:-1])
    for octave in range(count):
        value = noise(points * 2.0**octave + 7.3 * octave, seed + octave)
        total += 0.5**octave * (1.0 - 2.0 * np.abs(value) if ridged else value)
    return total


def stone() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (V, 3), faces (F, 3) and places of their corners in the images (F, 3, 2)."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    way, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces)
    radius = 1.0 + 0.22 * octaves(1.3 * way, 1) + 0.05 * octaves(3.0 * way, 11, ridged=True)
    place = np.column_stack(
        [np.arctan2(way[:, 1], way[:, 0]) / (2.0 * np.pi) + 0.5, np.arcsin(np.clip(way[:, 2], -1.0, 1.0)) / np.pi + 0.5]
    )
    uv = place[faces]
    # A pole has the longitude of the face's other corners, and a face on the seam goes on beyond it.
    polar = np.abs(way[:, 2])[faces] > 1.0 - 1e-9
    u = np.where(polar, np.nan, uv[..., 0])
    u = np.where(np.nanmax(u, axis=1, keepdims=True) - u > 0.5, u + 1.0, u)
    uv[..., 0] = np.where(np.isnan(u), np.nanmean(u, axis=1, keepdims=True), u)
    return way * radius[:, None] * (1.0, 0.85, 0.7), faces, uv


def _ways() -> np.ndarray:
    """Directions (H, W, 3) that the middles of texels lie in, the top row first."""
    height, width = SIZE
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    latitude = (0.5 - (np.arange(height) + 0.5) / height) * np.pi
    across = np.cos(latitude)[:, None]
    return np.stack(
        [across * np.cos(longitude), across * np.sin(longitude), np.broadcast_to(np.sin(latitude)[:, None], SIZE)],
        axis=-1,
    )


def _mixed(first: np.ndarray, second: tuple[float, float, float], share: np.ndarray) -> np.ndarray:
    return first + np.clip(share, 0.0, 1.0)[..., None] * (np.array(second) - first)


def lichen() -> np.ndarray:
    """How much of a texel lichen covers, (H, W) in [0, 1]."""
    return np.clip(6.0 * (octaves(2.5 * _ways(), 21) - 0.25), 0.0, 1.0)


def stone_color() -> np.ndarray:
    """(H, W, 3) uint8, sRGB: grey and brown, light veins, lichen."""
    ways = _ways()
    grain = 0.10 * octaves(14.0 * ways, 31)[..., None]
    color = _mixed(np.full((*SIZE, 3), (0.52, 0.50, 0.47)), (0.45, 0.33, 0.22), 0.5 + octaves(1.7 * ways, 41))
    color = _mixed(color, (0.86, 0.83, 0.78), 8.0 * (octaves(2.2 * ways, 51, 3, ridged=True) - 1.35))
    color = _mixed(color, (0.50, 0.51, 0.27), lichen())
    return _bytes(color * (1.0 + grain))


def stone_roughness() -> np.ndarray:
    """(H, W) uint8, alpha times 255: a worn stone, and lichen, which is rough."""
    return _bytes(0.32 + 0.05 * octaves(6.0 * _ways(), 61) + 0.35 * lichen())


def ground() -> np.ndarray:
    """(H, W, 3) uint8, sRGB: 6 x 6 flags, each of its own grey, with joints."""
    size, count = 256, 6
    y, x = (np.indices((size, size)) + 0.5) * count / size
    tone = np.random.default_rng(71).uniform(0.45, 0.68, (count, count))[y.astype(int), x.astype(int)]
    edge = np.minimum.reduce([x % 1.0, 1.0 - x % 1.0, y % 1.0, 1.0 - y % 1.0])
    rough = 0.08 * octaves(np.stack([2.0 * x, 2.0 * y, np.zeros_like(x)], axis=-1), 81)
    color = (tone + rough)[..., None] * (1.0, 0.97, 0.92)
    return _bytes(_mixed(color, (0.20, 0.19, 0.17), 1.5 - edge / 0.03))


def window() -> np.ndarray:
    """(H, W, 3) uint8, sRGB: panes of coloured glass between black leads."""
    glass = [(240, 200, 90), (200, 50, 40), (60, 90, 200), (70, 150, 80), (250, 240, 220)]
    chosen = np.random.default_rng(91).integers(0, len(glass), (6, 4))
    panes = np.repeat(np.repeat(np.array(glass, np.uint8)[chosen], 10, axis=0), 10, axis=1)
    rows, columns = np.indices(panes.shape[:2]) % 10
    return np.where(((rows == 0) | (columns == 0))[..., None], 0, panes).astype(np.uint8)


IMAGES = {"stone.png": stone_color, "stone_roughness.png": stone_roughness, "ground.png": ground, "window.png": window}


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)


def _write_mesh(path: Path) -> None:
    """PLY, the places as the list `texcoord` of the faces."""
    vertices, faces, uv = stone()
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    head += "property float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    head += "property list uchar float texcoord\nend_header\n"
    rows = np.zeros(len(faces), [("n", "u1"), ("corners", "<i4", 3), ("m", "u1"), ("places", "<f4", 6)])
    rows["n"], rows["m"], rows["corners"], rows["places"] = 3, 6, faces, uv.reshape(-1, 6)
    path.write_bytes(head.encode() + vertices.astype("<f4").tobytes() + rows.tobytes())


if __name__ == "__main__":
    _write_mesh(LIBRARY / "meshes" / "stone.ply")
    for name, made in IMAGES.items():
        PIL.Image.fromarray(made()).save(LIBRARY / "images" / name, optimize=True)
