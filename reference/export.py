"""A stand-alone Mitsuba script that renders a scene's references without Termwise, to the same bits.

The folder holds the meshes (PLY), the sky (NPY), `references.json` with the scenes as Mitsuba dictionaries, the
settings and the seeds, the sources of the plugins and integrators as the package `integrals`, and `render.py`.
"""

import importlib.metadata
import json
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import attrs

from termwise import reference
from termwise.reference import backend, translate
from termwise.scenes.limits import Limit
from termwise.scenes.model import Scene
from termwise.scenes.store import ROOT

SOURCES = (
    "wavefront.py",
    "rays.py",
    "paths.py",
    "prepare.py",
    "film.py",
    "kernel_reference.py",
    "density.py",
    "bsdf.py",
    "dielectric.py",
    "distant.py",
    "sky.py",
    "share.py",
    "physical.py",
    "second.py",
    "terms",
)

SCRIPT = '''\
"""Render the references that references.json lists: one float32 NPY file (H, W, 3) per replicate.

    python render.py [NAME ...]      needs only: pip install REQUIREMENTS

The bits are those of the variant and versions named in references.json. `llvm_ad_rgb` needs an LLVM that Dr.Jit
works with (19 does, 14 to 16 abort), which DRJIT_LIBLLVM_PATH names. On Linux Mitsuba needs libatomic.so.1.
"""

import json
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np

here = Path(__file__).resolve().parent
references = json.loads((here / "references.json").read_text())
mi.set_variant(references["variant"])

sys.path.insert(0, str(here))
from integrals import prepare  # noqa: E402  their classes need the variant

loaded = prepare.Loaded(references["scene"], here)
for name in sys.argv[1:] or references["renders"]:
    render = references["renders"][name]
    for number, seed in enumerate(render["seeds"]):
        images = loaded.render(render["limit"], spp=render["spp"], seed=seed)
        image = images[render["part"]].astype(np.float32)
        if render["factor"] != 1.0:
            image = image * np.float32(render["factor"])
        np.save(here / f"{name}-{number:04d}.npy", image)
        print(f"{name}-{number:04d}.npy mean {image.mean(axis=(0, 1), dtype=float)}")
'''


def export(
    scene: Scene, limits: Mapping[str, Limit], folder: Path, *, spp: int, seed: int, replicates: int = 1
) -> None:
    """Write the stand-alone script for the given references.

    Parameters
    ----------
    scene : the scene.
    limits : the integrals, each under the name of its image files.
    folder : a new or empty folder.
    spp, seed, replicates : as in `reference.render`; the script's file NAME-000k.npy has the bits of
        `reference.replicate(scene, limit, spp=spp, seed=seed, replicate=k)` on the same backend.

    Raises
    ------
    ValueError : the folder is not empty.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ValueError(f"{folder}: exists and is not empty: allowed is a new or empty folder")
    loaded = reference.loaded(scene)
    renders = {}
    for name, limit in limits.items():
        served = reference.shared(scene, limit)
        renders[name] = {
            "limit": attrs.asdict(served),
            "part": reference.parts(served).index(limit.term),
            "factor": limit.factor,
            "spp": spp,
            "seeds": [reference.rng_seed(served, seed, number) for number in range(replicates)],
        }
    versions = {package: importlib.metadata.version(package) for package in ("mitsuba", "drjit", "numpy", "scipy")}
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
        written = Path(temporary) / folder.name
        (written / "integrals").mkdir(parents=True)
        translate.describe(scene, written)  # meshes and sky
        for source in SOURCES:
            path = ROOT / "reference" / source
            copy = shutil.copytree if path.is_dir() else shutil.copyfile
            copy(path, written / "integrals" / source)
        shutil.rmtree(written / "integrals" / "terms" / "__pycache__", ignore_errors=True)
        (written / "integrals" / "__init__.py").write_text(
            '"""Sources of the references\' plugins and integrators."""\n'
        )
        references = {
            "variant": backend.active().variant,
            "versions": versions,
            "renders": renders,
            "scene": loaded.description,
        }
        (written / "references.json").write_text(json.dumps(references, indent=1))
        requirements = " ".join(f"{package}=={version}" for package, version in versions.items())
        (written / "render.py").write_text(SCRIPT.replace("REQUIREMENTS", requirements))
        if folder.exists():
            folder.rmdir()
        written.rename(folder)
