"""Is the picture right? Replicates of ours and of Mitsuba's reference, pair by pair, and the verdict as they arrive.

The verdict is that of `reports.statistics.rule`, on the variants and the chain that the picture has. It is looked at
with 4, 8 and 16 replicates a side. An error may be proven at any look, at a third of the level each (Bonferroni); that
there is none is said at the last look alone, so that looking often cannot make it true.
"""

import multiprocessing
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from termwise.reference import store
from termwise.renderer.engine import Cancelled, Engine
from termwise.renderer.plan import needs_photons, skipped
from termwise.reports.live.state import CHAIN, State
from termwise.reports.pages.pictures import diverge, error_scale, relative_error
from termwise.reports.statistics import verdict
from termwise.reports.statistics.accumulation import Statistics, measure
from termwise.reports.statistics.metrics import rmse
from termwise.reports.statistics.replicates import REPLICATES_NEEDED
from termwise.reports.statistics.rule import decide
from termwise.scenes.limits import Limit
from termwise.scenes.terms import TABLE, TERMS, Term

COUNT = 16
LOOKS = (4, 8, COUNT)
_SPP = 64


@attrs.frozen(eq=False)
class TruthRow:
    """A term beside its reference, as far as both are.

    Attributes
    ----------
    word : the verdict, or that none is due yet.
    bias, low, high : relative bias of the luminance and its 90 % interval; NaN before the first look.
    rmse : of the means of both sides, radiance.
    sentence : of the verdict.
    error : (H, W, 3) uint8, signed error in colours; `scale` is its end, relative to the term's mean.
    """

    term: Term
    word: str
    bias: float
    low: float
    high: float
    rmse: float
    sentence: str
    error: np.ndarray
    scale: float


@attrs.frozen(eq=False)
class TruthView:
    """All terms after `done` of `count` replicates a side, each of `samples` samples; `error` says why it ended."""

    state: State
    done: int
    count: int
    samples: int
    rows: tuple[TruthRow, ...]
    error: str = ""


class Truth:
    """Judges a state in the background; Mitsuba runs in a process of its own, which `cancel` ends at once.

    Parameters
    ----------
    state : what is judged.
    samples : of each of our replicates.
    folder : references are kept below it.
    publish : called from the thread with each view.
    """

    def __init__(self, state: State, samples: int, folder: Path, publish: Callable[[TruthView], object]) -> None:
        self.state, self.samples = state, samples
        self._folder, self._publish = folder, publish
        self._cancel = threading.Event()
        self._thread = threading.Thread(target=self._work, name="termwise truth", daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """End the work."""
        self._cancel.set()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end; whether it has come."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _work(self) -> None:
        scene = self.state.scene
        terms: list[Term] = [term for term in TERMS if skipped(scene, term) is None]
        limits = {term: self.state.variant(term).limit(scene, self.samples) for term in terms}
        context = multiprocessing.get_context("spawn")
        ours_end, their_end = context.Pipe(duplex=False)
        arguments = (their_end, scene, limits, self.state.seed, self._folder / "references")
        process = context.Process(target=_references, args=arguments, daemon=True)
        rows: tuple[TruthRow, ...] = ()
        done = 0
        try:
            process.start()
            their_end.close()
            stacks: dict[Term, tuple[list[np.ndarray], list[np.ndarray]]] = {term: ([], []) for term in terms}
            words: dict[Term, str] = {}
            with Engine(scene) as engine:
                objects = engine.geometry().object
                while done < COUNT:
                    for term in terms:
                        stacks[term][0].append(self._ours(engine, term, done))
                        stacks[term][1].append(self._received(ours_end))
                    done += 1
                    rows = self._rows(stacks, words, objects, done)
                    self._publish(TruthView(self.state, done, COUNT, self.samples, rows))
        except Cancelled:
            pass
        except Exception as fault:  # Mitsuba's and the child's are many; the page tells them and lives on
            why = " ".join(str(fault).split()) or type(fault).__name__
            self._publish(TruthView(self.state, done, COUNT, self.samples, rows, f"no truth: {why}"))
        finally:
            process.kill()
            process.join()
            ours_end.close()

    def _ours(self, engine: Engine, term: Term, number: int) -> np.ndarray:
        *_, (_, image, _) = engine.prefixes(
            self.state.variant(term),
            samples=self.samples,
            seed=self.state.seed,
            replicate=number,
            chain=CHAIN,
            cancel=self._cancel,
        )
        return image

    def _received(self, pipe: Any) -> np.ndarray:
        while not pipe.poll(0.1):
            if self._cancel.is_set():
                raise Cancelled
        try:
            found = pipe.recv()
        except EOFError:
            raise RuntimeError("the process of Mitsuba ended") from None
        if isinstance(found, str):
            raise RuntimeError(found)
        return found

    def _rows(
        self,
        stacks: dict[Term, tuple[list[np.ndarray], list[np.ndarray]]],
        words: dict[Term, str],
        objects: np.ndarray,
        done: int,
    ) -> tuple[TruthRow, ...]:
        scene = self.state.scene
        names = [thing.name for thing in scene.objects]
        pairs: dict[Term, tuple[np.ndarray, np.ndarray]] = {
            term: (np.array(ours), np.array(theirs)) for term, (ours, theirs) in stacks.items()
        }
        measured: dict[Term, Statistics] = {}
        if done >= REPLICATES_NEEDED:
            scale = sum(float(theirs.mean()) for _, theirs in pairs.values()) or 1.0
            measured = {
                term: measure(ours, theirs, objects=objects, object_names=names, scale=scale)
                for term, (ours, theirs) in pairs.items()
            }
        tests = len(LOOKS) * sum(each.tests for each in measured.values())
        rows = []
        for term, (ours, theirs) in pairs.items():
            error, _ = relative_error(ours.mean(axis=0), theirs.mean(axis=0))
            ends = error_scale([error])
            outcome = None
            if term in measured:
                outcome = self._decided(term, measured[term], max(tests, 1))
                if done in LOOKS:
                    words[term] = _word(outcome, done)
            rows.append(
                TruthRow(
                    term,
                    words.get(term, f"none before {LOOKS[0]} replicates"),
                    outcome.bias if outcome else np.nan,
                    outcome.bias_low if outcome else np.nan,
                    outcome.bias_high if outcome else np.nan,
                    rmse(theirs.mean(axis=0), ours.mean(axis=0)),
                    outcome.sentence if outcome and done == COUNT else "",
                    diverge(error, scale=ends),
                    ends,
                )
            )
        return tuple(rows)

    def _decided(self, term: Term, statistics: Statistics, tests: int) -> verdict.Verdict:
        scene, variant = self.state.scene, self.state.variant(term)
        # Photons at the vertices of a chain bring their kernel's bias, which is allowed for as in direct.
        in_chain = bool(TABLE[term].meets) and needs_photons(scene, variant, CHAIN) is not None
        kernel = variant.kernel_based(scene) or in_chain
        return decide(
            statistics,
            tests=tests,
            kind=variant.kind,
            kernel=kernel,
            allowance=0.01 if kernel else 0.0,
            margin=verdict.MARGIN if variant.kind == "right" else 0.005,
            judged=variant.judged,
            reason="the camera sees nothing of it",
        )


def _word(outcome: verdict.Verdict, done: int) -> str:
    if outcome.verdict is None:
        return "NOT JUDGED"
    proven = outcome.verdict in {words[0] for words in verdict.WORDS.values()}
    return outcome.verdict if proven or done == COUNT else "no error proven so far"


def _references(
    pipe: Any, scene: Any, limits: dict[Term, Limit], seed: int, folder: Path
) -> None:  # pragma: no cover, in a process of its own
    """Send the reference replicates of each term, or one line that says why there are none."""
    try:
        for number in range(COUNT):
            for limit in limits.values():
                kept = store.replicates(scene, limit, spp=_SPP, seed=seed, count=number + 1, folder=folder)
                if len(kept.images) <= number:
                    raise RuntimeError(kept.shortfall)
                pipe.send(kept.images[number])
    except BrokenPipeError:
        pass
    except Exception as fault:  # told to the page
        pipe.send(" ".join(str(fault).split()) or type(fault).__name__)
