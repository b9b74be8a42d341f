"""The stand-alone script gives the same bits with Termwise out of reach."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from termwise import reference
from termwise.reference.export import export
from termwise.reference.native import fetched_folder
from termwise.scenes.limits import Kernel, Limit, correct, physical
from termwise.scenes.model import Ambient, Camera, Material, Mesh, Object, PointLight, Scene, Sky


def wall(*, smooth: bool) -> Scene:
    corners = [[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0], [-2, 2, 2], [2, 2, 2]]
    thing = Object(
        "wall",
        Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 3], [3, 2, 5], [3, 5, 4]], smooth=smooth),
        Material(gloss=0.3),
    )
    texture = np.random.default_rng(0).random((4, 8, 3)).astype(np.float32)
    return Scene(
        "wall",
        Camera(position=(2.0, -2.0, 2.0), target=(0.0, 0.0, 0.0)),
        (thing,),
        lights=(PointLight((0.0, 0.0, 1.0), (1.0, 1.0, 1.0)),),
        ambient=Ambient((1.0, 1.0, 1.0), range=1.0),
        sky=Sky(texture=texture, radius=9.0),
        resolution=(12, 8),
    )


def test_exported_script_reproduces_the_bits(tmp_path):
    limits = {
        "ambient": Limit("ambient", factor=np.pi),
        "specular": correct("specular", "all"),
        "physical-direct": physical("direct"),
    }
    assert_reproduced(wall(smooth=True), limits, tmp_path)


def test_exported_photon_maps_reproduce_the_bits(tmp_path):
    limits = {
        "kernel": Limit("direct", scope="all", kernel=Kernel("simpson", "scattered", radius=0.5, passes=3)),
        "nearest": Limit("direct", scope="all", kernel=Kernel("nearest", nearest=5, photons=500)),
    }
    assert_reproduced(wall(smooth=False), limits, tmp_path)


def assert_reproduced(scene: Scene, limits: dict[str, Limit], tmp_path: Path) -> None:
    folder = tmp_path / "exported"
    export(scene, limits, folder, spp=3, seed=5, replicates=2)
    outside = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    # Where the system has no libatomic the script's user must install it; here the fetched one stands for that.
    outside["LD_LIBRARY_PATH"] = ":".join({str(file.parent) for file in fetched_folder().rglob("lib*.so.*")})
    # -I: neither the working folder nor PYTHONPATH; the project itself is then hidden by an import that fails.
    hidden = "import sys; sys.modules.update(scenes=None, reference=None, renderer=None, reports=None, termwise=None);"
    run = f"import runpy; sys.argv = ['render.py']; runpy.run_path({str(folder / 'render.py')!r}, run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-I", "-c", hidden + run], cwd=tmp_path, env=outside, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for name, limit in limits.items():
        for number in range(2):
            image = np.load(folder / f"{name}-{number:04d}.npy")
            expected = reference.replicate(scene, limit, spp=3, seed=5, replicate=number)
            np.testing.assert_array_equal(image, expected)
            assert image.any()


def test_a_folder_with_files_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    scene = Scene("empty", Camera(position=(1.0, 0.0, 0.0), target=(0.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match="not empty"):
        export(scene, {}, tmp_path, spp=1, seed=1)
