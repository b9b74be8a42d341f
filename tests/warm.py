"""Compile the kernels that tests use, a process a core, into their cache: `python -m tests.warm LANE PROCESSES`.

Test processes that begin with nothing compiled would each compile what the other is compiling. Kernels that take long
come first, so that the processes end together.
"""

import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor

import attrs

from termwise.renderer import Engine, render
from termwise.renderer.terms import Chain
from termwise.scenes.model import Scene, Texture
from termwise.scenes.terms import Term
from tests.scenes import of_glass, small

Kernel = tuple[Term, str, Chain]
# Each has a kernel of its own; a chain of paths needs no photons, so that one process alone compiles their tracing.
KERNELS: tuple[Kernel, ...] = (
    ("specular", "vndf", "path"),
    ("direct", "photon-map", "next-event"),
    ("direct", "path", "path"),
    ("direct", "next-event", "path"),
    ("ambient", "cosine", "path"),
    ("direct", "paper", "path"),
    ("background", "seen", "path"),
)
# Of the kinds of scene that rare tests have: what they take of these.
SOME = {
    "lights": KERNELS,
    "shadow rule": KERNELS[:6],
    "leaf": KERNELS[:5],
    "images": KERNELS[:5],
    "glass": (("transmission", "vndf", "next-event"), *KERNELS[1:3]),
    "lamp under an image": KERNELS[1:3],
}
LANES: dict[str, tuple[tuple[str, Kernel], ...]] = {"test": tuple(("plain", kernel) for kernel in KERNELS)}
LANES["exam"] = (*LANES["test"], *((kind, kernel) for kind, kernels in SOME.items() for kernel in kernels))


def scene_of(kind: str) -> Scene:
    """Few pixels of a scene whose kernels are those of its kind."""
    if kind in ("lights", "leaf"):
        return small(kind, 4)
    if kind == "plain":
        return small("two_cubes", 4)
    if kind == "shadow rule":
        return small("two_cubes", 4, shadows="paper")
    if kind == "glass":
        return of_glass(small("two_cubes", 4))
    scene = small("wild", 4)
    if kind == "images":
        return attrs.evolve(
            scene, objects=tuple(each for each in scene.objects if not isinstance(each.emission, Texture))
        )
    return scene


def compiled(kind: str, kernel: Kernel) -> str:
    """Render a few pixels with one kernel."""
    term, variant, chain = kernel
    scene = scene_of(kind)
    render(scene, term, variant=variant, samples=1, chain=chain, threads=1)
    with Engine(scene, threads=1) as engine:
        engine.geometry()
    return f"{kind}: {term} {variant}"


if __name__ == "__main__":
    lane, processes = sys.argv[1:]
    with ProcessPoolExecutor(int(processes), multiprocessing.get_context("spawn")) as pool:
        for name in pool.map(compiled, *zip(*LANES[lane], strict=True)):
            print(f"compiled: {name}", flush=True)
