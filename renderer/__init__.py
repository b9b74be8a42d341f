"""The paper's decomposition, from scratch in Numba: `L_o = L_ambient + L_direct + L_specular (+ L_background)`.

`render(scene, term)` gives a TermImage, `render_terms` those of several; `terms` holds the variants, `plan` what a
scene needs.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from termwise.renderer.auto import chosen
from termwise.renderer.engine import Engine
from termwise.renderer.photon_map import KEPT_BYTES
from termwise.renderer.terms import DEFAULTS, VARIANTS, Chain, Variant, find
from termwise.scenes.arguments import seed_of, whole
from termwise.scenes.load import load
from termwise.scenes.model import Scene
from termwise.scenes.terms import TermImage

__all__ = ["DEFAULTS", "VARIANTS", "Engine", "Variant", "chosen", "find", "render", "render_terms"]


def render(
    scene: Scene | str | Path,
    term: str,
    *,
    variant: str | None = None,
    samples: int = 16,
    replicates: int = 1,
    seed: int = 0,
    chain: Chain = "next-event",
    threads: int | None = None,
    keep: bool = True,
) -> TermImage:
    """Render one term.

    Parameters
    ----------
    scene : a scene, the name of one of the library, or the path of a scene file.
    term : one of `scenes.terms.TERMS`: "ambient", "direct", "specular", "transmission" or "background".
    variant : the estimator; the term's default without a name, which of direct is "auto": of all bounces by paths or by
        photons, as the scene is (`chosen` says which, and why).
    samples : samples per pixel and replicate, of the mean pixel where contrast decides (`renderer.counts`); powers of
        two keep the points well spread.
    replicates : independent repetitions; 2 or more give a variance, and `judge` takes 4 or more.
    seed : in [0, 2^64 - 1]; equal seeds give equal bits, for any number of threads.
    chain : what the other terms are at the vertices of a specular chain, see `renderer.terms.variant.Chain`.
    threads : None: one a core.
    keep : whether the replicates are kept beside their mean, as `judge` needs them; K images in place of two.

    Returns
    -------
    The image, its variance and its replicates: radiance, linear Rec. 709, in the scene's unit.

    Raises
    ------
    ValueError : an unknown term or variant, a count or a seed that is none; the message lists what is allowed. A scene
        that cannot be loaded is a `FileError`, which is one too.
    """
    images = render_terms(
        load(scene),
        {term: variant},
        samples=samples,
        replicates=replicates,
        seed=seed,
        chain=chain,
        threads=threads,
        keep=keep,
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
    keep: bool = False,
    report: Callable[[str, int, int], None] = lambda term, done, total: None,
) -> dict[str, TermImage]:
    """Render several terms, the same bits as one by one; see `render`.

    One tree serves all of them, and so do photon maps where two terms mean the same: the `seconds` of the later one are
    then without them. Direct and specular take 0.64 to 0.84 of the processor time (three scenes, 16 samples).

    Parameters
    ----------
    variants : the estimator of each term to render; None: the term's default.
    report : called with (what runs, samples done, samples of all terms and replicates), first before a term compiles.
    """
    samples, replicates, seed = whole("samples", samples), whole("replicates", replicates), seed_of(seed)
    total, before = samples * replicates * len(variants), 0
    report("choice of estimators, compiling", before, total)
    estimators = {term: chosen(scene, term, variant) for term, variant in variants.items()}
    images: dict[str, list[np.ndarray]] = {term: [] for term in variants}
    seconds = dict.fromkeys(variants, 0.0)
    kept = KEPT_BYTES if len(variants) > 1 else 0
    with Engine(scene, threads=threads, kept_bytes=kept) as engine:
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
        term: TermImage.from_replicates(np.stack(images[term]), samples=samples, seconds=seconds[term], keep=keep)
        for term in variants
    }
