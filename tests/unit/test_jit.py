"""Compilation: an edit reaches every kernel that uses it, no fastmath, and kernels compile only when they run.

Rationale: a cached function of Numba keeps the stale result of an edited callee in another module, which no test of
numbers can show on a machine whose cache is fresh. The tests work on a copy of the project with a cache of its own.
"""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from termwise.renderer.geometry.simd import available
from termwise.renderer.jit import _imports, closure_digest, kernel

pytestmark = pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT", "0") != "0", reason="compilation is what is tested")

PROJECT = Path(__file__).resolve().parents[2]
SOURCES = sorted((PROJECT / "renderer").rglob("*.py"))


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """A copy of the renderer and the scenes' Python sources."""
    folder = tmp_path_factory.mktemp("project")
    for package in ("renderer", "scenes"):
        shutil.copytree(
            PROJECT / package, folder / "termwise" / package, ignore=shutil.ignore_patterns("__pycache__", "library")
        )
    (folder / "termwise" / "__init__.py").touch()
    return folder


def run(folder: Path, code: str) -> str:
    """Standard output of `code` run in a child process on the copy, compiled, with a cache of its own."""
    environment = os.environ | {
        "TERMWISE_CACHE": str(folder / "cache"),
        "PYTHONPATH": str(folder),
        "NUMBA_DISABLE_JIT": "0",
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def edit(path: Path, before: str, after: str) -> None:
    text = path.read_text("utf-8")
    assert text.count(before) == 1
    path.write_text(text.replace(before, after), "utf-8")


@pytest.mark.slow
def test_an_edited_callee_in_another_module_is_compiled_anew(copy):
    """`camera_ray` is run, `vector.mad` that it calls is edited, and it is run again: the result is the edited one.

    The caller's own file is unchanged, so Numba alone would load what it cached; undone, the first result is back.
    """
    code = """
import numpy as np
from termwise.renderer.arrays import from_scene
from termwise.renderer.camera import camera_ray
from termwise.renderer.rng import root
from termwise.renderer.sobol import Sampler
from termwise.scenes.model import Camera
from termwise.scenes.model import Scene
scene = Scene("s", Camera((0., 0., 0.), (0., 1., 0.), pixel="corner"), resolution=(4, 4))
print(camera_ray(from_scene(scene).camera, 1, 3, Sampler(root(0, 0), np.uint32(0))).direction.x)
"""
    before = run(copy, code)
    mad = "return Vec3(a.x * s + b.x, a.y * s + b.y, a.z * s + b.z)"
    edit(copy / "termwise/renderer/vector.py", mad, mad.replace("a.x * s + b.x", "a.x * s - b.x"))
    edited = run(copy, code)
    edit(copy / "termwise/renderer/vector.py", mad.replace("a.x * s + b.x", "a.x * s - b.x"), mad)
    assert edited != before
    assert run(copy, code) == before


@pytest.mark.slow
def test_what_a_render_compiles(copy):
    """No kernel of a term that does not run, nothing but the trees where terms are skipped; functions stay callable.

    `root` and `fold`, called by Python before and after a kernel has compiled `fold` and cached it, give equal results:
    a kernel's version has no entry for Python, and the cache does not know them apart: jumped to, it ends the process.
    """
    calls = """
import numpy as np
from termwise.renderer.rng import fold
from termwise.renderer.rng import root
print(int(root(1, 2)), int(fold(np.uint64(3), 4)))
"""
    kernel = """
import attrs
from termwise.renderer import render
from termwise.renderer.jit import compiled_kernels
from termwise.scenes.analytic import disc_over_plane
scene = attrs.evolve(disc_over_plane(height=1.0, radius=1.0, sides=3), resolution=(1, 1))
for term in ("direct", "specular", "background"):
    render(scene, term, samples=1)
print(*compiled_kernels(), sep=",")
print(render(scene, "ambient", samples=1).mean.sum())
print(*compiled_kernels(), sep=",")
"""
    skipped, first, rendered = run(copy, kernel).split("\n")
    # The trees are built whatever is rendered; the wide one where the processor has the vectors.
    builders = {"_build", "_plan", "_write"} if available() else {"_build"}
    assert set(skipped.split(",")) <= builders
    assert set(rendered.split(",")) == builders | {"_occlusion"}
    called = run(copy, calls)
    assert len(set(called.split())) == 2
    assert run(copy, calls + kernel).split("\n")[::2] == [called, first]
    assert run(copy, kernel + calls).split("\n")[1::2] == [first, called]


@pytest.mark.slow
def test_machine_code_is_made_of_kernels_alone(copy):
    """The object that Numba keeps of a kernel defines it, that of a function linked into kernels does not.

    Another process that finds the function cached, and not the kernel, compiles the kernel from it: the same image.
    """
    code = """
import attrs
from termwise.renderer import render
from termwise.renderer.jit import KERNELS
from termwise.renderer.rng import fold
from termwise.scenes.analytic import disc_over_plane
scene = attrs.evolve(disc_over_plane(height=1.0, radius=1.0, sides=3), resolution=(1, 1))
print(render(scene, "ambient", samples=1).mean.sum())
[kernel] = [each for each in KERNELS if each.__name__ == "_occlusion"]
for function in (kernel.compiled, fold._for_kernels):
    each = function.overloads.values()
    print(*{it.fndesc.mangled_name.encode() in (it.library._compiled_object or b"") for it in each})
"""
    cached = copy / "cache/numba"
    shutil.rmtree(cached, ignore_errors=True)
    image, *made = run(copy, code).split("\n")
    assert made == ["True", "False"]
    kernels = [path for path in cached.rglob("*") if "_occlusion" in path.name]
    assert kernels
    for path in kernels:
        path.unlink()
    assert run(copy, code).split("\n")[:2] == [image, "True"]


@pytest.mark.slow
def test_digest_changes_with_what_a_module_reaches_and_nothing_else(copy):
    """Editing `terms.direct` changes its digest and those of terms that reach it, not those of others."""
    code = (
        "from termwise.renderer.jit import closure_digest as d; "
        "print(*(d(f'termwise.renderer.{m}') for m in {0!r}.split()))"
    )
    modules = "vector camera terms.direct terms.ambient terms.specular"
    before = run(copy, code.replace("{0!r}", repr(modules))).split()
    with (copy / "termwise/renderer/terms/direct.py").open("a") as file:
        file.write("# a comment\n")
    after = run(copy, code.replace("{0!r}", repr(modules))).split()
    changed = {name for name, a, b in zip(modules.split(), before, after, strict=True) if a != b}
    assert changed == {"terms.direct", "terms.specular"}
    # What runs kernels is nothing that they reach: an edit of it compiles none anew.
    for name in ("engine", "plan"):
        with (copy / f"termwise/renderer/{name}.py").open("a") as file:
            file.write("# a comment\n")
    assert run(copy, code.replace("{0!r}", repr(modules))).split() == after


def test_digest_covers_what_annotations_alone_name():
    """A cached function keeps the layout of its arguments: the readers of materials, and the lights, know the scene."""
    for name in ("material", "lights.point", "lights.face"):
        reached, waiting = set(), {f"termwise.renderer.{name}"}
        while waiting:
            reached |= waiting
            waiting = set().union(*(_imports(module)[1] for module in waiting)) - reached
        assert {f"termwise.renderer.{each}" for each in ("arrays", "surface", "lights.face")} <= reached


def test_digest_covers_transitive_imports():
    """`terms.specular` reaches `vector` through others too, and modules that share no import differ."""
    digests = {name: closure_digest(f"termwise.renderer.{name}") for name in ("vector", "rng", "terms.specular")}
    assert len(set(digests.values())) == 3


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PROJECT)))
def test_options_of_numba_are_named_in_one_place(path):
    """No `fastmath` anywhere, and no use of numba outside jit.py (and its intrinsics, types and pipelines)."""
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword):
            assert node.arg != "fastmath"
        extends = ("jit.py", "simd.py", "by_reference.py", "compiling.py", "dealing.py")
        if isinstance(node, ast.Import | ast.ImportFrom) and path.name not in extends:
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [item.name for item in node.names]
            assert not any(name.split(".")[0] == "numba" for name in names)


@kernel
def _index(table: np.ndarray, narrow: np.ndarray, i: int, out: np.ndarray) -> None:
    out[0] = table[i, 1]
    out[1] = table[narrow[0], narrow[1]]
    out[2] = table[-1, -2]
    out[3] = table[i][-1]
    out[-1] = table[1:, 0].sum()
    out[i + 3] = table[narrow[2], 1]


def test_indices():
    """Of 64 and 32 bits, in pairs, of a row, of a slice; constants count from the end where they are negative."""
    out = np.zeros(6)
    _index(np.arange(6.0).reshape(2, 3), np.array([1, 2, 0], np.int32), 2 - 1, out)
    assert out.tolist() == [4.0, 5.0, 4.0, 5.0, 1.0, 3.0]


def test_users_own_cache_folder_stays(copy):
    """Numba's CACHE_DIR is set during our calls only."""
    code = (
        "from numba.core import config as c; before = c.CACHE_DIR; "
        "import termwise.renderer; print(c.CACHE_DIR == before)"
    )
    assert run(copy, code) == "True"
