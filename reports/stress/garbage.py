"""Garbage: what is no scene is refused by an error that names it, and what is one gives an image of numbers.

NaN, infinities and extremes stand in every number of a scene file; bytes of scene files and meshes are changed at
random; meshes have random vertices and indices. Each is either refused in one line, or rendered: all terms, every
pixel finite and not negative. The paper's program checks nothing, nor is it fed by files: only ours is measured.
"""

import re
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import trimesh

from termwise.renderer import render_terms
from termwise.reports.stress.row import Row
from termwise.scenes.load import load
from termwise.scenes.model import Camera, Mesh, Object, PointLight, Scene

VALUES = ("nan", "inf", "-inf", "-1.0", "-0.0", "0.0", "1e-300", "1e-30", "1e30", "1e300", "'text'", "[]", "true")
# Table -> its fields with good values. The numbers of work (photons, bounces) are refused or small.
FIELDS: dict[str, dict[str, str]] = {
    "": {"resolution": "[4, 4]", "max_bounces": "2", "exposure": "1.0", "rings": "4"},
    "[camera]": {
        "position": "[0.3, -3.0, 1.0]",
        "target": "[0.0, 0.0, 0.0]",
        "up": "[0.0, 0.1, 1.0]",
        "fov": "50.0",
        "near": "0.1",
    },
    "[ambient]": {"color": "[0.5, 0.4, 0.3]", "range": "3.0"},
    "[sky]": {"color": "[0.2, 0.3, 0.4]", "center": "[0.0, 0.0, 0.0]", "radius": "100.0"},
    "[photons]": {"count": "64", "radius": "0.2", "nearest": "8", "survival": "0.5"},
    "[[lights]]": {"position": "[0.5, -0.5, 2.0]", "intensity": "[3.0, 2.0, 1.0]"},
    "[[objects]]": {
        "name": '"box"',
        "shape": '"box"',
        "size": "[1.0, 1.0, 1.0]",
        "scale": "1.2",
        "rotation": "[0.0, 10.0, 20.0]",
        "translation": "[0.0, 0.0, 0.5]",
        "color": "[0.5, 0.6, 0.7]",
        "gloss": "0.3",
        "roughness": "0.4",
        "f0": "[0.04, 0.04, 0.04]",
        "emission": "[0.0, 0.0, 0.0]",
    },
}
_NUMBER = re.compile(r"-?\d+(\.\d+)?")


def text(changed: str = "", value: str = "") -> str:
    """A scene file, with the first number of the field `TABLE.KEY` replaced."""
    lines = []
    for table, fields in FIELDS.items():
        lines.append(table)
        for key, good in fields.items():
            bad = _NUMBER.sub(value, good, count=1) if f"{table}.{key}" == changed else good
            lines.append(f"{key} = {bad}")
    return "\n".join(lines) + "\n"


def faulty(make: Callable[[], Scene], *, names: tuple[str, ...] = ()) -> bool:
    """Whether a scene is neither refused in one line, with one of `names` in it, nor gives an image of numbers."""
    try:
        scene = make()
        images = render_terms(
            scene, {"ambient": None, "direct": None, "specular": None, "background": None}, samples=1, threads=1
        )
    except ValueError as error:
        message = str(error)
        return "\n" in message or not message or not (not names or any(name in message for name in names))
    return not all(np.isfinite(image.mean).all() and (image.mean >= 0.0).all() for image in images.values())


def fields(count: int) -> Iterator[Row]:
    """Every number of a scene file."""
    for table, keys in FIELDS.items():
        for key, good in keys.items():
            if not _NUMBER.search(good):
                continue

            def astray(table: str = table, key: str = key) -> float:
                bad = 0
                with tempfile.TemporaryDirectory() as folder:
                    path = Path(folder) / "scene.toml"
                    for value in VALUES:
                        path.write_text(text(f"{table}.{key}", value), "utf-8")
                        # A scale or place of 1e300 is refused as what it makes of the vertices.
                        bad += faulty(lambda path=path: load(path), names=(key, "vertices", "area"))
                return float(bad)

            name = f"{table.strip('[]')}.{key}".lstrip(".")
            yield Row(name, f"of {len(VALUES)} values, those neither refused by name nor rendered", 0.0, astray)


def _changed(good: bytes, rng: np.random.Generator) -> bytes:
    """Bytes with some of them replaced, left out or doubled, or cut short."""
    data = bytearray(good)
    for _ in range(rng.integers(1, 6)):
        at = int(rng.integers(len(data)))
        what = rng.integers(4)
        if what == 0:
            data[at] = int(rng.integers(256))
        elif what == 1:
            data[at : at + int(rng.integers(1, 9))] = b""
        elif what == 2:
            data[at:at] = data[at : at + int(rng.integers(1, 9))]
        elif rng.integers(4) == 0:
            del data[at:]
        if not data:
            return b""
    return bytes(data)


def files(count: int) -> Iterator[Row]:
    """Scene files and meshes with bytes changed, and of random bytes."""
    tries = max(8, count // 32)
    ball = trimesh.creation.icosphere(subdivisions=1)
    for kind in ("toml", "ply", "obj", "stl", "glb"):

        def astray(kind: str = kind) -> float:
            rng = np.random.default_rng(41)
            exported = text().encode() if kind == "toml" else ball.export(file_type=kind)
            good = exported.encode() if isinstance(exported, str) else bytes(exported)
            bad = 0
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "scene.toml"
                for index in range(tries):
                    data = rng.bytes(int(rng.integers(1, 400))) if index % 8 == 0 else _changed(good, rng)
                    if kind == "toml":
                        path.write_bytes(data)
                    else:
                        mesh = '[[objects]]\nname = "m"\nshape = "mesh"\n' + f'file = "mesh.{kind}"\n'
                        path.write_text(text().partition("[[objects]]")[0] + mesh, "utf-8")
                        (Path(folder) / f"mesh.{kind}").write_bytes(data)
                    bad += faulty(lambda path=path: _small(load(path)))
            return float(bad)

        figure = f"of {tries}, those neither refused in one line nor rendered"
        yield Row(f"bytes of .{kind} files", figure, 0.0, astray)


def _small(scene: Scene) -> Scene:
    """The scene, refused where a changed digit asks for much work."""
    if max(scene.resolution) > 64 or scene.photons.count > 10_000:
        raise ValueError("resolution, photons: more than the lab renders")
    return scene


def mesh(rng: np.random.Generator) -> Scene:
    """A scene of one mesh of random vertices, magnitudes 1e-8 to 1e8, some NaN or infinite, and random faces."""
    vertices = rng.normal(size=(int(rng.integers(0, 12)), 3))
    vertices *= 10.0 ** (rng.uniform(-8, 8) if rng.integers(2) else rng.uniform(-8, 8, vertices.shape))
    if len(vertices) and rng.integers(4) == 0:
        vertices[rng.integers(len(vertices)), rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf, 1e300])
    faces = rng.integers(0, max(1, len(vertices)) + (rng.integers(8) == 0), (int(rng.integers(0, 20)), 3))
    if len(faces) and rng.integers(8) == 0:
        faces[0, 0] = -1
    with np.errstate(over="ignore"):
        thing = Object("random", Mesh.from_arrays(vertices, faces, smooth=bool(rng.integers(2))))
    size = float(np.abs(vertices).max())
    return Scene(
        "random",
        Camera((0.1 * size, -3.0 * size, size), (0.0, 0.0, 0.0)),
        (thing,),
        lights=(PointLight((size, -size, 2.0 * size), (size * size, size * size, size * size)),),
        resolution=(4, 4),
    )


def meshes(count: int) -> Iterator[Row]:
    """Meshes in memory."""
    tries = max(8, count // 32)

    def astray() -> float:
        rng = np.random.default_rng(42)
        return float(sum(faulty(lambda: mesh(rng)) for _ in range(tries)))

    yield Row("random meshes", f"of {tries}, those neither refused in one line nor rendered", 0.0, astray)


def rows(count: int) -> Iterator[Row]:
    """All rows of the group."""
    for make in (fields, files, meshes):
        yield from make(count)
