"""The paper's decomposition, from scratch in Numba: `L_o = L_ambient + L_direct + L_specular (+ L_background)`.

`render(scene, term)` gives a TermImage, `render_terms` those of several; `terms` holds the variants, `plan` what a
scene needs.
"""

from collections.abc import Callable

import numpy as np

from termwise.renderer.engine import Engine, whole
from termwise.renderer.photon_map import KEPT_BYTES
from termwise.renderer.terms import DEFAULTS, VARIANTS, Chain, Variant, find
from termwise.scenes.model import Scene
from termwise.scenes.terms import TermImage

__all__ = ["DEFAULTS", "VARIANTS", "Engine", "Variant", "find", "render", "render_terms"]


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
    term : one of `scenes.terms.TERMS`: "ambient", "direct", "specular" or "background".
    variant : the estimator; the term's default without a name.
    samples : samples per pixel and replicate; powers of two keep the points well spread.
    replicates : independent repetitions; 2 or more give a variance.
    seed : equal seeds give equal bits, for any number of threads.
    chain : what the other terms are at the vertices of a specular chain, see `renderer.terms.variant.Chain`.
    threads : None: one a core.
    adaptive : whether a pilot, which is then discarded, gives more samples to the noisier tiles.

    Raises
    ------
    ValueError : an unknown term or variant, a count below 1, adaptive counts with photon maps; the message lists what
        is allowed.
    """
    images = render_terms(
        scene,
        {term: variant},
        samples=samples,
        replicates=replicates,
        seed=seed,
        chain=chain,
        threads=threads,
        adaptive=adaptive,
    )
    return images[term]


def render_terms(
    scene: Scene,
    variants: dict[str, str | None],
    *,
    samples: int = 16,
    replicates: int = 1,
    seed: int = 0,
    chain: Chain = "next-event",
    threads: int | None = None,
    adaptive: bool = False,
    report: Callable[[str, int, int], None] = lambda term, done, total: None,
) -> dict[str, TermImage]:
    """Render several terms, the same bits as one by one; see `render`.

    One tree serves all of them, what the camera rays of one term meet serves the next, and so do photon maps where both
    mean the same: its `seconds` are then without them. Direct and specular take 0.64 to 0.84 of the processor time with
    photon maps (three scenes, 16 samples), all four terms 0.84 to 0.90 without (64 samples).

    Parameters
    ----------
    variants : the estimator of each term to render; None: the term's default.
    report : called with (what runs, samples done, samples of all terms and replicates), first before a term compiles.
    """
    if replicates < 1:
        raise ValueError(f"replicates = {replicates}: allowed is at least 1")
    samples = whole(samples)
    estimators = {term: find(term, variant) for term, variant in variants.items()}
    images: dict[str, list[np.ndarray]] = {term: [] for term in variants}
    seconds = dict.fromkeys(variants, 0.0)
    kept = KEPT_BYTES if len(variants) > 1 else 0
    total, before = samples * replicates * len(estimators), 0
    with Engine(scene, threads=threads, adaptive=adaptive, kept_bytes=kept) as engine:
        for replicate in range(replicates):
            for term, estimator in estimators.items():
                report(f"{term}, compiling", before, total)
                *_, (_, image, spent) = engine.prefixes(
                    estimator,
                    samples=samples,
                    seed=seed,
                    replicate=replicate,
                    chain=chain,
                    progress=lambda done, _, term=term, before=before: report(term, before + done, total),
                )
                before += samples
                images[term].append(image)
                seconds[term] += spent
    return {
        term: TermImage.from_replicates(np.stack(images[term]), samples=samples, seconds=seconds[term])
        for term in variants
    }
