"""The live picture: the bits of `termwise render`, no more work than a change asks for, and an end to all of it."""

import gc
import threading
import time
import weakref

import attrs
import numpy as np
import pytest

from termwise.renderer import render_terms
from termwise.renderer.engine import Engine
from termwise.reports.live.live import KEPT, Frame, Live, _Sum
from termwise.reports.live.state import State, put
from termwise.scenes.model import Photons
from termwise.scenes.terms import TERMS, total
from tests.scenes import small

# What has not come by then never will, however busy the machine.
WAIT_S = 300.0


@pytest.fixture(scope="module", autouse=True)
def kernels(compiled):
    """Compiled before anything is waited for: the first time takes minutes on a busy machine."""
    if compiled:
        for name in ("two_cubes", "cornell_box", "monkey"):
            rendered(small_state(name, compiled), 1)
        rendered(put(small_state("two_cubes", compiled), ("variants", "ambient"), "paper"), 1)


class Watch:
    """Collects frames; `until` waits for one."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self._new = threading.Condition()

    def __call__(self, frame: Frame) -> None:
        with self._new:
            self.frames.append(frame)
            self._new.notify_all()

    def until(self, number: int, samples: int = 0) -> Frame:
        """The first frame of state `number` in which all that is rendered has as many samples."""

        def found() -> Frame | None:
            for frame in self.frames:
                views = frame.terms.values()
                if frame.number == number and all(v.samples >= samples or v.status == "skipped" for v in views):
                    return frame
            return None

        with self._new:
            assert self._new.wait_for(lambda: found() is not None, WAIT_S), [f.number for f in self.frames]
        frame = found()
        assert frame is not None
        return frame


@pytest.fixture
def watch():
    watch = Watch()
    live = Live(watch, threads=2)
    yield live, watch
    live.close()
    assert live.join(WAIT_S)


def small_state(name: str, compiled: bool, **changes) -> State:
    side, count = (24, 500) if compiled else (3, 20)
    scene = small(name, side, photons=Photons(count=count, radius=0.3))
    return State(scene, **{"samples": 4, **changes})


def rendered(state: State, samples: int) -> dict[str, np.ndarray]:
    images = render_terms(state.scene, {**state.variants}, samples=samples, seed=state.seed)
    return {term: images[term].mean for term in TERMS}


@pytest.mark.parametrize("name", ["two_cubes", "cornell_box"])
def test_the_picture_has_the_bits_of_render(name, watch, compiled):
    live, seen = watch
    state = small_state(name, compiled, samples=5, seed=7)
    state = put(state, ("variants", "ambient"), "paper")
    live.show(state)
    for samples in (1, 5):
        frame, expected = seen.until(1, samples), rendered(state, samples)
        for term in TERMS:
            if frame.terms[term].samples == samples:
                assert frame.terms[term].image.tobytes() == expected[term].tobytes()
        if frame.samples == samples:
            assert frame.total.tobytes() == total(*expected.values()).tobytes()
    assert seen.until(1, 5).at_rest
    assert seen.until(1, 5).samples == 5


def test_a_change_renders_only_what_it_touches(watch, compiled):
    live, seen = watch
    state = small_state("two_cubes", compiled)
    live.show(state)
    before = seen.until(1, 4)
    changed = put(state, ("scene", "objects", 0, "material", "roughness"), 0.9)
    changed = put(changed, ("scene", "objects", 0, "material", "f0", 0), 0.5)
    live.show(changed)
    first, after = seen.until(2), seen.until(2, 4)
    for term in ("ambient", "direct", "background"):
        assert first.terms[term].reused
        assert first.terms[term].image is before.terms[term].image
    assert not after.terms["specular"].reused
    assert after.total.tobytes() == total(*rendered(changed, 4).values()).tobytes()


def test_undo_finds_the_samples_that_were_taken(watch, compiled):
    live, seen = watch
    state = small_state("two_cubes", compiled)
    live.show(state)
    before = seen.until(1, 4)
    live.show(put(state, ("scene", "camera", "fov"), 50.0))
    seen.until(2, 4)
    live.show(state)
    again = seen.until(3)
    assert again.at_rest
    there = [term for term in TERMS if before.terms[term].status != "skipped"]
    assert "ambient" in there
    for term in there:
        assert again.terms[term].image is before.terms[term].image


def test_more_samples_go_on_from_those_there_are(watch, compiled):
    live, seen = watch
    state = small_state("cornell_box", compiled, samples=2)
    live.show(state)
    seen.until(1, 2)
    live.show(attrs.evolve(state, samples=6))
    after = seen.until(2, 6)
    assert seen.until(2).terms["ambient"].reused
    assert after.total.tobytes() == total(*rendered(state, 6).values()).tobytes()


def test_what_is_skipped_says_why(watch, compiled):
    live, seen = watch
    state = small_state("cornell_box", compiled)
    live.show(put(state, ("scene", "toggles", "lighting"), False))
    frame = seen.until(1, 4)
    assert frame.terms["direct"].status == "skipped"
    assert frame.terms["direct"].reason == "lighting is off"
    assert not frame.terms["direct"].image.any()


def test_a_new_state_breaks_off_what_it_makes_useless(watch, compiled):
    """A state that would take for ever is left at once; the one after it is whole."""
    live, seen = watch
    endless = small_state("cornell_box", compiled, samples=2**20)
    live.show(endless)
    seen.until(1)
    for number in range(2, 12):
        live.show(put(endless, ("scene", "camera", "fov"), 40.0 + number))
    last = put(small_state("cornell_box", compiled), ("scene", "camera", "fov"), 45.0)
    live.show(last)
    found = seen.until(12, 4).total
    assert found is not None
    assert found.tobytes() == total(*rendered(last, 4).values()).tobytes()
    assert [frame.number for frame in seen.frames] == sorted(frame.number for frame in seen.frames)


def test_a_drag_shows_pictures(watch, compiled):
    """Changes that come faster than pictures: some are left out, none of those begun is, before its first picture."""
    live, seen = watch
    state = small_state("cornell_box", compiled, samples=2**20)
    number, end = 0, time.monotonic() + WAIT_S
    while len({frame.number for frame in seen.frames if frame.total is not None}) < 5:
        assert time.monotonic() < end
        number += 1
        live.show(put(state, ("scene", "camera", "fov"), 40.0 + 0.01 * (number % 1000)))


def test_a_step_called_off_as_it_ended_goes_on_later(watch, compiled):
    live, seen = watch
    state = small_state("cornell_box", compiled)
    live.show(state)
    seen.until(1, 4)
    for each in live._sums.values():
        each.cancel.set()
    live.show(attrs.evolve(state, samples=8))
    assert seen.until(2, 8).at_rest


def test_pause_keeps_the_picture_and_resume_goes_on(watch, compiled):
    live, seen = watch
    live.pause()
    state = small_state("cornell_box", compiled, samples=4)
    live.show(state)
    frame = seen.until(1, 1)
    assert {view.status for view in frame.terms.values()} == {"stopped", "skipped"}
    live.pause(False)
    assert seen.until(1, 4).at_rest


def test_a_pause_ends_with_equally_many_samples(watch, compiled):
    """What is exported then is what one command renders."""
    live, seen = watch
    state = small_state("cornell_box", compiled, samples=2**20)
    live.show(state)
    seen.until(1, 2)
    live.pause()
    end = time.monotonic() + WAIT_S
    while not seen.frames[-1].at_rest:
        assert time.monotonic() < end
        time.sleep(0.01)
    frame = seen.frames[-1]
    assert frame.samples is not None
    assert 2 <= frame.samples < 2**20
    if frame.samples <= 2**12:  # as many as a test can render again
        found = frame.total
        assert found is not None
        assert found.tobytes() == total(*rendered(state, frame.samples).values()).tobytes()


def test_two_sessions_do_not_disturb_each_other(compiled):
    watches = Watch(), Watch()
    states = small_state("cornell_box", compiled), small_state("monkey", compiled)
    sessions = [Live(watch, threads=1) for watch in watches]
    for live, state in zip(sessions, states, strict=True):
        live.show(state)
    for watch, state in zip(watches, states, strict=True):
        picture = watch.until(1, 4).total
        assert picture is not None
        assert picture.tobytes() == total(*rendered(state, 4).values()).tobytes()
    for live in sessions:
        live.close()
        assert live.join(WAIT_S)


def test_a_closed_session_stops_its_work(compiled):
    watch = Watch()
    live = Live(watch, threads=1)
    live.show(small_state("cornell_box", compiled, samples=2**20))
    watch.until(1)
    before = threading.active_count()
    live.close()
    assert live.join(WAIT_S)
    assert threading.active_count() < before
    frames = len(watch.frames)
    time.sleep(0.3)
    assert len(watch.frames) == frames


def test_a_fault_is_told_and_the_next_state_rendered(watch, compiled, monkeypatch):
    live, seen = watch
    state = small_state("cornell_box", compiled)

    def broken(*arguments, **options):
        raise MemoryError("no room for photons")

    with monkeypatch.context() as patched:
        patched.setattr("termwise.reports.live.live.Engine.prefixes", broken)
        live.show(state)
        assert seen.until(1).error == "no room for photons"
    live.show(state)
    assert seen.until(2, 4).at_rest


def test_a_late_first_sample_is_preceded_by_a_quarter_of_the_pixels(watch, compiled, monkeypatch):
    monkeypatch.setattr("termwise.reports.live.live.FIRST_S", 0.0)
    live, seen = watch
    state = small_state("cornell_box", compiled)
    live.show(state)
    seen.until(1, 4)
    live.show(put(state, ("scene", "camera", "fov"), 50.0))
    last = seen.until(2, 4)
    assert last.total is not None
    preview = next(frame for frame in seen.frames if frame.number == 2)
    assert {view.status for view in preview.terms.values()} == {"preview", "skipped"}
    assert preview.total is not None
    assert preview.total.shape == last.total.shape
    assert preview.samples == 0
    assert last.total.tobytes() == total(*rendered(last.state, 4).values()).tobytes()


def test_what_is_held_is_bounded(watch, compiled, monkeypatch, request):
    """However many states were shown, a few sums and their engines are kept, and no thread of another.

    Without Python's collector, which looks at old objects so seldom that hundreds of megabytes would wait for it.
    """
    engines: list[weakref.ref[Engine]] = []
    sums: list[weakref.ref[_Sum]] = []

    def engine(*arguments, **options) -> Engine:
        made = Engine(*arguments, **options)
        engines.append(weakref.ref(made))
        return made

    def begun(*arguments) -> _Sum:
        made = _Sum(*arguments)
        sums.append(weakref.ref(made))
        return made

    monkeypatch.setattr("termwise.reports.live.live.Engine", engine)
    monkeypatch.setattr("termwise.reports.live.live._Sum", begun)
    gc.collect()
    gc.disable()
    request.addfinalizer(gc.enable)
    live, seen = watch
    threads = threading.active_count()
    state = small_state("cornell_box", compiled, samples=1)
    changes = 40
    for number in range(1, changes + 1):
        live.show(put(state, ("scene", "camera", "fov"), 40.0 + number))
        seen.until(number, 1)
        seen.frames.clear()
    most = KEPT + len(TERMS)

    def alive(made: list) -> int:
        return sum(each() is not None for each in made)

    assert len(engines) >= changes
    assert len(sums) >= changes
    end = time.monotonic() + WAIT_S
    # What was let go ends by itself, a little later.
    while alive(sums) > most or alive(engines) > most or threading.active_count() - threads > 2 * most:
        assert time.monotonic() < end, (alive(sums), alive(engines), threading.active_count())
        time.sleep(0.01)
