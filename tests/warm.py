"""Compile the renderer's kernels, a process a core, into the cache that tests use.

Test processes that begin with nothing compiled would each compile what the other is compiling. Kernels that take long
come first, so that the processes end together.
"""

import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor

from termwise.renderer import Engine, render
from termwise.renderer.terms import Chain
from tests.scenes import small

# Each has a kernel of its own; a chain of paths needs no photons, so that one process alone compiles their tracing.
KERNELS: tuple[tuple[str, str, Chain], ...] = (
    ("specular", "vndf", "path"),
    ("direct", "photon-map", "next-event"),
    ("direct", "path", "path"),
    ("direct", "next-event", "path"),
    ("ambient", "cosine", "path"),
    ("direct", "paper", "path"),
    ("background", "seen", "path"),
)


def compiled(kernel: tuple[str, str, Chain]) -> str:
    """Render a few pixels with one kernel."""
    term, variant, chain = kernel
    scene = small("two_cubes", 4)
    render(scene, term, variant=variant, samples=1, chain=chain, threads=1)
    with Engine(scene, threads=1) as engine:
        engine.geometry()
    return f"{term} {variant}"


if __name__ == "__main__":
    with ProcessPoolExecutor(int(sys.argv[1]), multiprocessing.get_context("spawn")) as pool:
        for name in pool.map(compiled, KERNELS):
            print(f"compiled: {name}", flush=True)
