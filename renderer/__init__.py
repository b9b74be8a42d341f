"""The paper's decomposition, from scratch in Numba: `L_o = L_ambient + L_direct + L_specular (+ L_background)`.

`render(scene, term)` gives a TermImage; `terms` holds the variants, `plan` what a scene needs.
"""

import numpy as np

from renderer.terms import DEFAULTS, VARIANTS, Chain, Variant, find
from renderer.tiles import Engine
from scenes.model import Scene
from scenes.terms import TermImage

__all__ = ["DEFAULTS", "VARIANTS", "Engine", "Variant", "find", "render"]


def render(
    scene: Scene,
    term: str,
    *,
    variant: str | None = None,
    samples: int = 16,
    replicates: int = 1,
    seed: int = 0,
    chain: Chain = "next-event",
    threads: int | None = None,
    adaptive: bool = False,
) -> TermImage:
    """Render one term.

    Parameters
    ----------
    scene : the scene.
    term : "ambient", "direct", "specular" or "background".
    variant : the estimator; the term's default without a name.
    samples : samples per pixel and replicate; powers of two keep the points well spread.
    replicates : independent repetitions; 2 or more give a variance.
    seed : equal seeds give equal bits, for any number of threads.
    chain : what the other terms are at the vertices of a specular chain, see `renderer.terms.variant.Chain`.
    threads : None: one a core.
    adaptive : whether a pilot, which is then discarded, gives more samples to the noisier tiles.

    Raises
    ------
    ValueError
        An unknown term or variant, a count below 1, adaptive counts with photon maps; the message lists what is
        allowed.
    """
    if replicates < 1:
        raise ValueError(f"replicates = {replicates}: allowed is at least 1")
    estimator = find(term, variant)
    images, seconds = [], 0.0
    with Engine(scene, threads=threads, adaptive=adaptive) as engine:
        for replicate in range(replicates):
            *_, (_, image, spent) = engine.prefixes(
                estimator, samples=samples, seed=seed, replicate=replicate, chain=chain
            )
            images.append(image)
            seconds += spent
    return TermImage.from_replicates(np.stack(images), samples=samples, seconds=seconds)
