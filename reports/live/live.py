"""A picture that is refined until it is good enough: `L_o` after N = 1, 2, 4, ... samples, term by term, by one thread.

The sum of a term's samples is kept as long as what it depends on stays (`State.content`): a change renders anew the
terms that it touches, and no other. Samples are taken in steps of about a tenth of a second, so that a change is seen
to at once. A step that a change has made useless is broken off, but never before the first picture of its state is
out: else a drag, which changes the state faster than pictures come, would show none. The image after N samples has the
bits of `termwise render --samples N`: the same samples are added in the same order, whatever the steps.
"""

import ctypes
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Any, Literal

import attrs
import numpy as np

from termwise.renderer.engine import Cancelled, Engine
from termwise.renderer.plan import skipped
from termwise.reports.live.state import CHAIN, State
from termwise.scenes.terms import TERMS, Term, total

STEP_S = 0.1
FIRST_S = 0.15
"""First samples of the touched terms that may take longer follow a quarter of the pixels and of the photons."""
KEPT = 8
"""Sums that are kept for an undo."""
_TRIM_EVERY = 32  # changes
_MAP_BYTES = 2**25  # the first passes, which direct and specular share

Status = Literal["starting", "preview", "rendering", "done", "skipped", "stopped"]


@attrs.frozen(eq=False)
class TermView:
    """A term as it stands.

    Attributes
    ----------
    image : (H, W, 3) float64, the mean of `samples` samples; None before the first.
    samples : 0 for a preview, which has one sample for 2 x 2 pixels and a quarter of the photons.
    seconds : of rendering, compilation apart.
    status : what is being done about it.
    reused : whether these samples were taken before the last change.
    reason : why it is skipped, or "".
    """

    image: np.ndarray | None
    samples: int
    seconds: float
    status: Status
    reused: bool
    reason: str = ""


@attrs.frozen(eq=False)
class Frame:
    """What a page shows: the terms of one state.

    Attributes
    ----------
    state : whose picture it is.
    number : how many states came before.
    terms : each term.
    first_s : seconds from the change to the first picture of all terms; None before it.
    error : why rendering ended, or "".
    """

    state: State
    number: int
    terms: dict[Term, TermView]
    first_s: float | None
    error: str = ""

    @property
    def total(self) -> np.ndarray | None:
        """The sum (H, W, 3), in the order that makes it reproducible; None before there is one."""
        images = [self.terms[term].image for term in TERMS]
        if any(image is None for image in images):
            return None
        return total(*(image for image in images if image is not None))

    @property
    def samples(self) -> int | None:
        """The samples that all terms have; None where they differ, skipped ones apart."""
        counts = {view.samples for view in self.terms.values() if view.status != "skipped"}
        return counts.pop() if len(counts) == 1 else 0 if not counts else None

    @property
    def at_rest(self) -> bool:
        """Whether nothing more will be rendered."""
        return all(view.status in ("done", "skipped", "stopped") for view in self.terms.values())


class _Sum:
    """The samples of one term that were taken so far; `step` takes more."""

    def __init__(self, state: State, term: Term, engine: Engine) -> None:
        self.term: Term = term
        self.content = state.content(term)
        self.engine = engine
        self.samples, self.seconds = 0, 0.0
        self.image: np.ndarray | None = None
        self.cancel = threading.Event()
        self.broken = False
        self._goal = 0
        self._prefixes = engine.prefixes(
            state.variant(term),
            samples=2**20,
            seed=state.seed,
            replicate=0,
            chain=CHAIN,
            cancel=self.cancel,
            counts=self._counts(),
        )

    def _counts(self) -> Iterator[int]:
        """Where to stop next: at the goal, at the next power of two, or after a step's time."""
        while True:
            pace = self.seconds / self.samples if self.samples else STEP_S
            further = self.samples + max(1, int(STEP_S / max(pace, 1e-6)))
            power = 1 << self.samples.bit_length() if self.samples else 1
            yield max(self.samples + 1, min(further, power, self._goal))

    def step(self, goal: int) -> None:
        """Take some samples more, at most up to `goal`.

        Raises
        ------
        Cancelled : `cancel` was set; what the step had taken is lost, and the sum cannot go on.
        """
        self._goal = goal
        try:
            self.samples, self.image, self.seconds = next(self._prefixes)
        except BaseException:
            self.broken = True
            raise

    def close(self) -> None:
        """Let go of all that is held now: sum and generator know each other, and would wait for Python's collector."""
        self._prefixes = iter(())


class Live:
    """Renders the state that was asked for last, in a thread of its own.

    Parameters
    ----------
    publish : called from that thread with each new frame.
    threads : of the kernels; None: one a core.
    """

    def __init__(self, publish: Callable[[Frame], object], *, threads: int | None = None) -> None:
        self._publish = publish
        self._threads = threads
        self._changed = threading.Condition()
        self._wanted: tuple[int, State, float] | None = None
        self._number = 0
        self._paused = self._closed = False
        self._out = True  # the first picture of the state that is shown
        self._running: _Sum | None = None
        # Of the worker alone.
        self._shown: tuple[int, State, float] | None = None
        self._first_s: float | None = None
        self._error = ""
        self._told_paused = False
        self._sums: dict[Term, _Sum] = {}
        self._kept: OrderedDict[tuple, _Sum] = OrderedDict()
        self._reused: set[Term] = set()
        self._adopted = 0
        self._pace: dict[tuple[Any, ...], float] = {}
        self._thread = threading.Thread(target=self._work, name="termwise view", daemon=True)
        self._thread.start()

    def show(self, state: State) -> None:
        """Ask for another state; a step that it makes useless is broken off."""
        contents = {state.content(term) for term in TERMS}
        with self._changed:
            self._number += 1
            self._wanted = self._number, state, time.perf_counter()
            if self._running and self._out and self._running.content not in contents:
                self._running.cancel.set()
            self._changed.notify()

    def pause(self, paused: bool = True) -> None:
        """Stop refining as soon as all terms have equally many samples, or go on."""
        with self._changed:
            self._paused = paused
            self._changed.notify()

    def close(self) -> None:
        """End the work and the thread: what runs is broken off."""
        with self._changed:
            self._closed = True
            if self._running:
                self._running.cancel.set()
            self._changed.notify()

    def join(self, timeout: float | None = None) -> bool:
        """Wait for the end of the thread; whether it has ended."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _work(self) -> None:
        try:
            while self._turn():
                pass
        finally:
            for engine in {id(each.engine): each.engine for each in self._all()}.values():
                engine.pool.shutdown(cancel_futures=True)

    def _turn(self) -> bool:
        """Take up a new state if there is one, then one step; whether to go on."""
        with self._changed:
            self._changed.wait_for(self._awake)
            if self._closed:
                return False
            assert self._wanted is not None
            paused = self._told_paused = self._paused
            anew = self._out and self._wanted is not self._shown
            if anew:
                self._shown, self._out = self._wanted, False
            assert self._shown is not None
        number, state, since = self._shown
        try:
            if anew:
                self._first_s, self._error = None, ""
                self._adopt(state)
                self._preview(state, number, since)
            following = self._next(state, paused)
            if following is not None:
                with self._changed:
                    if self._closed or (self._out and self._wanted is not self._shown):
                        return not self._closed
                    self._running = following
                following.step(self._goal(state, paused))
                if following.samples == 1:
                    self._pace[_kind(state, following.term)] = following.seconds
        except Cancelled:
            return True
        except Exception as fault:  # whatever an estimator raises is told, and the page lives on
            self._error = " ".join(str(fault).split()) or type(fault).__name__
        finally:
            with self._changed:
                self._running = None
        views = self._views(state, paused or bool(self._error))
        # The first frame after a change is a whole picture, never one term of it.
        whole = all(view.image is not None for view in views.values())
        if whole and self._first_s is None:
            self._first_s = time.perf_counter() - since
        if whole or anew or self._error:
            self._tell(Frame(state, number, views, self._first_s, self._error))
        return True

    def _tell(self, frame: Frame) -> None:
        self._publish(frame)
        if frame.total is not None or frame.error:
            with self._changed:
                self._out = True

    def _awake(self) -> bool:
        """Whether there is something to do."""
        if self._closed or self._wanted is not self._shown:
            return True
        if self._shown is not None and self._paused != self._told_paused:
            return True
        return self._shown is not None and not self._error and self._next(self._shown[1], self._paused) is not None

    def _all(self) -> list[_Sum]:
        return [*self._sums.values(), *self._kept.values()]

    def _adopt(self, state: State) -> None:
        """Keep the sums that the state can use, and begin those that it lacks."""
        before = self._all()
        known = {each.content: each for each in before if not each.broken}
        engine: Engine | None = None
        sums: dict[Term, _Sum] = {}
        self._reused = set()
        for term in TERMS:
            if skipped(state.scene, term) is not None:
                continue
            found = known.get(state.content(term))
            if found is None:
                if engine is None:
                    engine = Engine(state.scene, threads=self._threads, kept_bytes=_MAP_BYTES)
                found = _Sum(state, term, engine)
            else:
                found.cancel.clear()  # a step that was called off as it ended
                if found.samples:
                    self._reused.add(term)
            sums[term] = found
        self._sums = sums
        used = {each.content for each in sums.values()}
        others = [each for each in before if each.content not in used and not each.broken and each.samples]
        self._kept = OrderedDict((each.content, each) for each in others[:KEPT])
        held = {id(each) for each in self._all()}
        alive = {id(each.engine) for each in self._all()}
        for each in before:
            if id(each) not in held:
                each.close()
            if id(each.engine) not in alive:
                each.engine.pool.shutdown(wait=False)
        self._adopted += 1
        if self._adopted % _TRIM_EVERY == 0:
            _trim()

    def _goal(self, state: State, paused: bool) -> int:
        """Samples of each term: the state's; or as many as the foremost has, for a picture of one count at rest."""
        foremost = max((each.samples for each in self._sums.values()), default=1)
        return min(state.samples, max(1, foremost)) if paused else state.samples

    def _next(self, state: State, paused: bool) -> _Sum | None:
        """The sum that has the fewest samples, if it is to have more."""
        goal = self._goal(state, paused)
        behind = [each for each in self._sums.values() if each.samples < goal and not each.broken]
        return min(behind, key=lambda each: each.samples, default=None)

    def _preview(self, state: State, number: int, since: float) -> None:
        """Show a sample for 2 x 2 pixels, where the first sample of all will be late, or may be."""
        new: list[Term] = [term for term, each in self._sums.items() if not each.samples]
        expected = sum(self._pace.get(_kind(state, term), math.inf) for term in new)
        if expected < FIRST_S or min(state.scene.resolution) < 2:
            return
        width, height = state.scene.resolution
        # A quarter of the photons at twice the radius: as many meet a point.
        photons = state.scene.photons
        fewer = attrs.evolve(photons, count=-(-photons.count // 4), radius=2.0 * photons.radius)
        coarse = attrs.evolve(state.scene, resolution=(width // 2, height // 2), photons=fewer)
        views = self._views(state, False)
        rows, columns = np.arange(height) * (height // 2) // height, np.arange(width) * (width // 2) // width
        with Engine(coarse, threads=self._threads, kept_bytes=_MAP_BYTES) as engine:
            for term in new:
                if self._closed:
                    raise Cancelled
                _, image, seconds = next(
                    engine.prefixes(state.variant(term), samples=1, seed=state.seed, replicate=0, chain=CHAIN)
                )
                self._pace[_kind(state, term)] = 4.0 * seconds
                grown = image[rows][:, columns]
                views[term] = attrs.evolve(views[term], image=grown, seconds=seconds, status="preview")
        self._tell(Frame(state, number, views, time.perf_counter() - since))

    def _views(self, state: State, stopped: bool) -> dict[Term, TermView]:
        width, height = state.scene.resolution
        black = np.zeros((height, width, 3))
        views = {}
        for term in TERMS:
            each = self._sums.get(term)
            if each is None:
                reason = skipped(state.scene, term) or ""
                views[term] = TermView(black, 0, 0.0, "skipped", False, reason)
                continue
            status: Status = "starting" if each.image is None else "rendering"
            if each.samples >= state.samples:
                status = "done"
            elif stopped and each.samples >= self._goal(state, True):
                status = "stopped"
            views[term] = TermView(each.image, each.samples, each.seconds, status, term in self._reused)
        return views


def _trim() -> None:
    """Give freed memory back to the system.

    glibc keeps what lies between pieces that are held, in a heap for every few threads, and each change has threads of
    its own. Other libraries have no such call.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def _kind(state: State, term: Term) -> tuple[Any, ...]:
    """Of a first sample: those of one kind take about as long."""
    scene = state.scene
    return scene.name, term, state.variant(term).name, scene.resolution, scene.photons, scene.max_bounces
