"""The page: NiceGUI elements around one `History` and one `Live` a tab."""

import asyncio
import base64
import fcntl
import io
import itertools
import math
import os
import re
import socket
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from markupsafe import escape
from PIL import Image

from termwise.renderer.plan import plan
from termwise.renderer.terms import Variant
from termwise.reports.live import state as states
from termwise.reports.live.guard import Guard
from termwise.reports.live.inputs import Input, groups
from termwise.reports.live.live import Frame, Live
from termwise.reports.live.state import CHAIN, History, State, Steps
from termwise.reports.live.truth import Truth, TruthView
from termwise.reports.pages.digits import DASH, interval
from termwise.reports.pages.pictures import display
from termwise.reports.pages.pictures import save as save_png
from termwise.reports.results.exr import write_exr
from termwise.scenes.load import library, load
from termwise.scenes.model import Scene
from termwise.scenes.save import save
from termwise.scenes.terms import TERMS, TOTAL, Term

DRAWN_S = 0.1
"""Pictures are sent no more often, but for the first after a change and the last."""
GAMMAS = 1.0, 3.0
"""Least and greatest gamma, as in the report's viewer."""
# A tab that is away for longer is closed, and has lost its state. Its work rests from the first moment; the browser is
# asked every 0.8 of this time whether it is there, and has 0.4 of it to answer: 3 s were too few on a busy machine.
_GONE_S = 30.0


def serve(
    scene: str | Scene, folder: Path, *, port: int | None, browser: bool, announce: Callable[[str], object]
) -> None:
    """Serve the page until interrupted.

    Parameters
    ----------
    scene : a scene, a name of the library, or the path of a scene file.
    folder : all that is saved goes there.
    port : None: a free one.
    browser : whether to open one.
    announce : called with the address.

    Raises
    ------
    ValueError : the port is in use, another page writes into the folder, the scene does not load.
    """
    first = State(load(scene))
    folder.mkdir(parents=True, exist_ok=True)
    with _alone(folder):
        port = _free(port)
        # NiceGUI keeps its own files in the working directory otherwise.
        os.environ["NICEGUI_STORAGE_PATH"] = str(folder / ".nicegui")
        from nicegui import app, ui

        app.add_middleware(Guard, port=port)

        @ui.page("/", title="Termwise: view")
        def page() -> None:
            Page(ui, first, folder)

        address = f"http://127.0.0.1:{port}/"
        announce(address)
        if browser:
            app.on_startup(lambda: webbrowser.open(address))
        ui.run(
            host="127.0.0.1",
            port=port,
            show=False,
            reload=False,
            dark=None,
            reconnect_timeout=_GONE_S,
            show_welcome_message=False,
            uvicorn_logging_level="error",
        )


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Hold the folder against a second server, which would overwrite what this one saves."""
    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"out = {folder}: another termwise view writes there: allowed is another folder") from None
        yield


def _free(port: int | None) -> int:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port or 0))
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise ValueError(f"port = {port}: {why}: allowed is a free one in [1, 65535], or none given") from None
        return probe.getsockname()[1]


def png(pixels: np.ndarray) -> str:
    """(H, W, 3) uint8 as a data address: nothing is left on the server."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=1)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


class Page:
    """One tab."""

    def __init__(self, ui: Any, state: State, folder: Path) -> None:
        self.ui, self.folder = ui, folder
        self.history = History(state)
        self.frame: Frame | None = None
        self.truth: Truth | None = None
        self._judged: State | None = None
        self._asked = 0  # truths so far: what one that was cancelled still tells is not the next one's
        self.shown = "sum"
        self.gamma: float | None = None  # of the pictures' curve; None: sRGB
        self.saved: Path | None = None
        self._fields: dict[Steps, list[Any]] = {}
        self._syncing = False
        self._drag: tuple[float, float] | None = None
        self._drawn = (0, 0.0)
        self._loop = asyncio.get_running_loop()
        self._pictures: dict[str, tuple[Any, Any]] = {}
        client = ui.context.client
        self._build()
        self.live = Live(self._on_frame)
        client.on_disconnect(lambda: self.live.pause(True))
        client.on_connect(lambda: self.live.pause(not self.pause.value))
        client.on_delete(self.close)
        self._show(state)

    def close(self) -> None:
        """End all work of the tab."""
        self.live.close()
        if self.truth:
            self.truth.cancel()

    # What the page consists of

    def _build(self) -> None:
        ui = self.ui
        ui.add_css((Path(__file__).parent / "page.css").read_text("utf-8"))
        with ui.row().classes("w-full items-center gap-2"):
            ui.label("Termwise").classes("text-xl").props("role=heading aria-level=1")
            ui.select(list(library()), label="scene", on_change=lambda e: self._load(e.value)).props(
                "dense outlined"
            ).classes("w-48")
            self.path = (
                ui.input("or a scene file")
                .props("dense outlined")
                .on("keydown.enter", lambda: self._load(self.path.value))
            )
            self.undo = ui.button("undo", on_click=lambda: self._show(self.history.undo())).props("dense flat no-caps")
            self.redo = ui.button("redo", on_click=lambda: self._show(self.history.redo())).props("dense flat no-caps")
            self.name = ui.input("name", value="mine").props("dense outlined").classes("w-32")
            for text, action in (
                ("save scene", self._save),
                ("copy command", self._copy),
                ("export PNG and EXR", self._export),
            ):
                ui.button(text, on_click=action).props("dense outline no-caps")
            self.pause = ui.switch("refine", value=True, on_change=lambda e: self.live.pause(not e.value))
        with ui.row().classes("panes w-full no-wrap items-start gap-6"):
            self.inputs = ui.column().classes("inputs shrink-0 gap-1").props('role=region aria-label="Inputs"')
            with ui.column().classes("grow min-w-0 gap-3"):
                with ui.row().classes("items-center gap-4"):
                    ui.toggle(
                        {"sum": "sum", "terms": "terms side by side"},
                        value="sum",
                        on_change=lambda e: self._arrange(e.value),
                    ).props("no-caps dense toggle-color=chosen")
                    with ui.element("div").classes("w-40"):
                        self._number(Input(("scene", "exposure"), "exposure", "", "factor"), "Picture")
                    self._curve()
                self.status = ui.label().props("role=status aria-live=polite")
                with ui.row().classes("w-full items-start gap-6"):
                    self.gallery = ui.element("div").classes("grow")
                    self.terms = ui.html(sanitize=False).classes("max-w-full overflow-x-auto")
                ui.label(
                    "Drag turns the camera, Shift and drag shifts it, the wheel comes nearer; on the picture: arrow "
                    "keys, with Shift, + and -."
                ).classes("text-sm opacity-70")
                self.message = ui.label().classes("text-sm").props("role=status aria-live=polite")
                self._truth_panel()
                ui.label("Plan").classes("text-lg").props("role=heading aria-level=2")
                self.plan = ui.html(sanitize=False).classes("w-full overflow-x-auto")
        self._list_inputs()
        self._arrange("sum")

    def _list_inputs(self) -> None:
        ui = self.ui
        self._fields = {path: fields for path, fields in self._fields.items() if path == ("scene", "exposure")}
        self.inputs.clear()
        with self.inputs:
            for number, (heading, inputs) in enumerate(groups(self.history.state)):
                with ui.expansion(heading, value=number == 0).classes("w-full").props("dense"):
                    for triple, parts in itertools.groupby(inputs, lambda each: each.part and each.path[:-1]):
                        if not triple:
                            for each in parts:
                                self._input(each, heading)
                            continue
                        first, *others = parts
                        ui.label(first.whole).classes("text-xs opacity-70 mt-2").props("aria-hidden=true")
                        with ui.row().classes("w-full no-wrap gap-3"):
                            for each in (first, *others):
                                with ui.column().classes("grow basis-0 min-w-0 gap-0"):
                                    self._input(each, heading)

    def _answers(self, each: Input) -> tuple[Callable[[Any], None], Callable[[Any], str | None]]:
        """What a field of an input does with a new value, and why it would refuse one."""
        return lambda event: self._change(each, event.value), lambda value: self._refusal(each, value)

    def _input(self, each: Input, heading: str) -> None:
        ui, value = self.ui, states.get(self.history.state, each.path)

        changed, refusal = self._answers(each)
        if each.choices:
            field = ui.select(list(each.choices), value=value, label=each.name, on_change=changed, validation=refusal)
            field._props["aria-label"] = f"{heading}: {each.name}"
            self._fields[each.path] = [field.props("dense hide-bottom-space").classes("w-full")]
        elif isinstance(value, bool):
            self._fields[each.path] = [ui.switch(each.name, value=value, on_change=changed)]
        else:
            self._number(each, heading)

    def _number(self, each: Input, heading: str) -> None:
        ui, value = self.ui, states.get(self.history.state, each.path)

        changed, refusal = self._answers(each)
        if each.word:  # a number field of a browser takes none
            field = ui.input(each.name, value=_text(value), on_change=changed, validation=refusal)
        else:
            label = each.part or each.name
            field = ui.number(label, value=value, step=each.step, on_change=changed, validation=refusal)
        field._props["aria-label"] = f"{heading}: {each.name}"
        fields = [field.props("dense debounce=200 hide-bottom-space").classes("w-full")]
        if each.high is not None:
            slider = ui.slider(min=each.low, max=each.high, step=each.step, value=value, on_change=changed)
            slider._props["aria-label"] = f"{heading}: {each.name}, slider"
            fields.append(slider.props("dense"))
        self._fields[each.path] = fields

    def _curve(self) -> None:
        """The curve by which pictures are shown: it belongs to the page, not to the scene."""
        ui = self.ui

        def changed() -> None:
            power.set_enabled(curve.value == "gamma")
            gamma = power.value if curve.value == "gamma" else None
            if gamma is None or refusal(gamma) is None:
                self.gamma = gamma
                if self.frame:
                    self._draw(self.frame, self._encoded(self.frame))

        def refusal(value: Any) -> str | None:
            low, high = GAMMAS
            given = isinstance(value, int | float) and low <= value <= high
            return None if given else f"gamma = {value}: allowed is a number in [{low:g}, {high:g}]"

        curve = ui.select({"srgb": "sRGB", "gamma": "gamma"}, value="srgb", label="curve", on_change=changed)
        curve.props("dense").classes("w-24")
        power = ui.number("gamma", value=2.2, step=0.1, on_change=changed, validation=refusal)
        power.props("dense debounce=200 hide-bottom-space").classes("w-24").set_enabled(False)
        for field, name in ((curve, "curve"), (power, "gamma")):
            field._props["aria-label"] = f"Picture: {name}"

    def _arrange(self, shown: str) -> None:
        """One picture, or one of each term."""
        ui = self.ui
        self.shown = shown
        names = [TOTAL] if self.shown == "sum" else list(TERMS)
        self.gallery.clear()
        self._pictures.clear()
        columns = 1 if self.shown == "sum" else 2
        width = "28rem" if columns == 1 else "40rem"
        self.gallery.style(f"max-width: {width}; min-width: 20rem")
        with self.gallery.style(f"display: grid; gap: .8rem; grid-template-columns: repeat({columns}, minmax(0, 1fr))"):
            for name in names:
                with ui.element("figure").classes("m-0"):
                    frame = ui.element("div").classes("picture-frame").props("tabindex=0")
                    frame.style("cursor: grab; touch-action: none")
                    self._camera_events(frame)
                    with frame:
                        picture = ui.element("img").classes("picture").props("draggable=false")
                    caption = ui.element("figcaption").classes("text-sm")
                    with caption:
                        text = ui.label(name)
                self._pictures[name] = picture, text
        if self.frame:
            self._draw(self.frame, self._encoded(self.frame))

    def _camera_events(self, frame: Any) -> None:
        at = ["clientX", "clientY", "buttons", "shiftKey"]
        frame.on("pointerdown", lambda e: setattr(self, "_drag", (e.args["clientX"], e.args["clientY"])), at)
        frame.on("pointermove", self._on_drag, at, throttle=0.05)
        frame.on(
            "wheel.prevent",
            lambda e: self._camera(lambda c: states.zoom(c, 1.1 if e.args["deltaY"] > 0 else 1 / 1.1)),
            ["deltaY"],
            throttle=0.05,
        )
        frame.on("keydown", self._on_key, ["key", "shiftKey"])

    def _on_drag(self, event: Any) -> None:
        if not event.args["buttons"] or self._drag is None:
            self._drag = None
            return
        x, y = event.args["clientX"], event.args["clientY"]
        right, down = x - self._drag[0], y - self._drag[1]
        self._drag = x, y
        if right or down:
            self._turn(right, down, event.args["shiftKey"])

    def _turn(self, right: float, down: float, shift: bool) -> None:
        if shift:
            self._camera(lambda camera: states.pan(camera, -0.002 * right, 0.002 * down))
        else:
            self._camera(lambda camera: states.orbit(camera, 0.4 * right, 0.4 * down))

    def _on_key(self, event: Any) -> None:
        steps = {"ArrowLeft": (-12, 0), "ArrowRight": (12, 0), "ArrowUp": (0, -12), "ArrowDown": (0, 12)}
        key = event.args["key"]
        if key in steps:
            self._turn(*steps[key], event.args["shiftKey"])
        elif key in "+-":
            self._camera(lambda camera: states.zoom(camera, 1 / 1.1 if key == "+" else 1.1))

    # What changes the state

    def _refusal(self, each: Input, value: Any) -> str | None:
        """Why the model does not take an input's value, for the place of the input."""
        try:
            states.put(self.history.state, each.path, _parsed(each, value))
        except ValueError as error:
            return str(error)
        return None

    def _change(self, each: Input, value: Any) -> None:
        """Take an input's value; the last good state stays where it is refused."""
        if self._syncing:
            return
        try:
            state = states.put(self.history.state, each.path, _parsed(each, value))
        except ValueError:  # `_refusal` says why
            return
        self.history.push(state, each.path)
        self._show(state)

    def _camera(self, move: Callable[[Any], Any]) -> None:
        state = self.history.state
        try:
            scene = attrs.evolve(state.scene, camera=move(state.scene.camera))
        except ValueError as error:
            self.message.text = str(error)
            return
        moved = attrs.evolve(state, scene=scene)
        self.history.push(moved, "camera")
        self._show(moved)

    def _load(self, name: str) -> None:
        try:
            state = attrs.evolve(self.history.state, scene=load(name))
        except ValueError as error:
            self.message.text = str(error)
            return
        self.message.text = f"loaded {name}"
        self.history.push(state, ("load", time.monotonic()))
        self._show(state)

    def _show(self, state: State) -> None:
        """Show a state: its inputs, its plan, and by and by its picture."""
        paths = {each.path for _, inputs in groups(state) for each in inputs} | {("scene", "exposure")}
        self._syncing = True
        if paths != set(self._fields):
            self._list_inputs()
        for path, fields in self._fields.items():
            value = states.get(state, path)
            for field in fields:
                given = _text(value) if isinstance(field.value, str) and not isinstance(value, str) else value
                if field.value != given:
                    field.value = given
        self._syncing = False
        self.undo.set_enabled(self.history.can_undo)
        self.redo.set_enabled(self.history.can_redo)
        if self._judged is not None and states.invalidated(self._judged, state):
            self._stop_truth()
            self._judged = None
            self.verdicts.content = ""
            self.errors.clear()
            self.progress.value = 0.0
            self.judged.text = "none of this state yet"
        self.live.show(state)

    # What the renderer tells

    def _on_frame(self, frame: Frame) -> None:
        """In the renderer's thread: encode, and let the page draw."""
        number, at = self._drawn
        now = time.monotonic()
        if frame.number == number and now - at < DRAWN_S and not (frame.at_rest or frame.error):
            return
        self._drawn = frame.number, now
        encoded = self._encoded(frame)
        self._loop.call_soon_threadsafe(self._draw, frame, encoded)

    def _encoded(self, frame: Frame) -> dict[str, str]:
        images: dict[str, np.ndarray | None] = {TOTAL: frame.total}
        images |= {term: view.image for term, view in frame.terms.items()}
        return {
            name: png(self._displayed(frame, image))
            for name, image in images.items()
            if image is not None and name in self._pictures
        }

    def _displayed(self, frame: Frame, image: np.ndarray) -> np.ndarray:
        return display(image, exposure=frame.state.scene.exposure, gamma=self.gamma)

    def _draw(self, frame: Frame, encoded: dict[str, str]) -> None:
        if self.frame is not None and frame.number < self.frame.number:
            return
        self.frame = frame
        for name, (picture, text) in self._pictures.items():
            caption = f"{name}: {_samples(frame, name)}"
            if name in encoded:
                picture._props["src"] = encoded[name]
                picture._props["data-samples"] = str(frame.samples)
            picture._props["alt"] = f"{frame.state.scene.name}, {caption}"
            picture.update()
            text.text = caption
        self.status.text = _status(frame)
        self.terms.content = _terms_table(frame)
        self.plan.content = _plan_table(frame)

    # Round trip

    def _file(self, suffix: str) -> Path:
        name = self.name.value or ""
        if not re.fullmatch(r"\w[\w .-]*", name):
            raise ValueError(f"name = {name!r}: allowed are letters, digits, blank, '.', '_' and '-'")
        return self.folder / f"{name}{suffix}"

    def _save(self) -> Path | None:
        try:
            path = self._file(".toml")
            save(self.history.state.scene, path)
        except (ValueError, OSError) as error:
            self.message.text = str(error)
            return None
        self.message.text = f"saved {path}; its report: termwise compare {path}"
        return path

    def _copy(self) -> None:
        state, frame = self.history.state, self.frame
        scene = states.named(state) or self._save()
        if scene is None or frame is None:
            return
        line = states.command(state, scene, frame.samples or 1)
        self.ui.clipboard.write(line)
        self.message.text = f"copied: {line}"

    def _export(self) -> None:
        frame = self.frame
        if frame is None or frame.total is None or not frame.samples:
            self.message.text = (
                "nothing to export: the terms have different numbers of samples; wait or switch refine off"
            )
            return
        try:
            exr, picture = self._file(".exr"), self._file(".png")
            parts = {term: view.image for term, view in frame.terms.items() if view.image is not None}
            header = {"software": "termwise", "digest": frame.state.scene.digest(), "samples": str(frame.samples)}
            write_exr(exr, {**parts, TOTAL: frame.total}, header)
            save_png(picture, self._displayed(frame, frame.total))
        except (ValueError, OSError) as error:
            self.message.text = str(error)
            return
        self.message.text = f"wrote {exr} and {picture}, {frame.samples} samples"

    # Truth

    def _truth_panel(self) -> None:
        ui = self.ui
        with ui.row().classes("items-center gap-3"):
            ui.label("Truth").classes("text-lg").props("role=heading aria-level=2")
            self.start = ui.button("render the reference", on_click=self._start_truth).props("dense outline no-caps")
            self.cancel = ui.button("cancel", on_click=self._stop_truth).props("dense flat no-caps")
            self.cancel.set_enabled(False)
            self.progress = (
                ui.linear_progress(0.0, show_value=False)
                .classes("w-40")
                .props('aria-label="progress of the reference"')
            )
            self.judged = ui.label("Mitsuba renders the integrals that this state's estimators mean.").props(
                "role=status aria-live=polite"
            )
        self.verdicts = ui.html(sanitize=False).classes("w-full overflow-x-auto")
        self.errors = (
            ui.element("div")
            .classes("w-full")
            .style("display: grid; gap: .8rem; grid-template-columns: repeat(auto-fill, minmax(12rem, 1fr))")
        )

    def _start_truth(self) -> None:
        self._stop_truth()
        self.errors.clear()
        taken = [view.samples for view in self.frame.terms.values() if view.samples] if self.frame else []
        samples = min(taken, default=1)
        self.live.pause()
        self.pause.value = False
        self.start.set_enabled(False)
        self.cancel.set_enabled(True)
        self.judged.text = "starting Mitsuba"
        self.progress.value = 0.0
        self.verdicts.content = ""
        self._judged = self.history.state
        self._asked += 1
        loop, asked = self._loop, self._asked
        self.truth = Truth(
            self.history.state,
            min(samples, 64),
            self.folder,
            lambda view: loop.call_soon_threadsafe(self._draw_truth, view, asked),
        )

    def _stop_truth(self) -> None:
        if self.truth:
            self.truth.cancel()
            self.truth = None
            self.judged.text = "cancelled"
        self.start.set_enabled(True)
        self.cancel.set_enabled(False)

    def _draw_truth(self, view: TruthView, asked: int) -> None:
        if self.truth is None or asked != self._asked:
            return
        self.progress.value = view.done / view.count
        self.judged.text = (
            view.error or f"{view.done} of {view.count} replicates of both sides, {view.samples} samples each"
        )
        self.verdicts.content = _verdict_table(view)
        self.errors.clear()
        with self.errors:
            for row in view.rows:
                with self.ui.element("figure").classes("m-0"):
                    self.ui.element("img").classes("picture").props(f"src={png(row.error)}").props(
                        f'alt="signed error of {row.term}: blue too dark, red too bright, white none"'
                    )
                    self.ui.label(f"{row.term}: signed error, ±{100 * row.scale:.3g} % of its mean").classes("text-sm")
        if view.done == view.count or view.error:
            self.truth = None
            self.start.set_enabled(True)
            self.cancel.set_enabled(False)


def _text(value: float | None) -> str:
    return "auto" if value is None else f"{value:.9g}"


def _parsed(each: Input, value: Any) -> Any:
    """A text that is a number, as one; anything else as it is, for the model to refuse."""
    if each.word == "auto" and value == "auto":
        return None
    try:
        return float(value) if each.word else value
    except (TypeError, ValueError):
        return value


def _samples(frame: Frame, name: str) -> str:
    if name == TOTAL:
        if any(view.status == "preview" for view in frame.terms.values()):
            return "preview, one sample for 2 × 2 pixels"
        return (
            f"{frame.samples} samples" if frame.samples is not None else "its terms have different numbers of samples"
        )
    view = frame.terms[name]
    if view.status == "skipped":
        return f"skipped: {view.reason}"
    if view.status == "preview":
        return "preview, one sample for 2 × 2 pixels"
    return f"{view.samples} samples, {view.seconds:.2f} s"


def _status(frame: Frame) -> str:
    if frame.error:
        return f"stopped: {frame.error}"
    if frame.total is None:
        return "starting: kernels that no run has compiled yet take a minute, once"
    reused = [term for term, view in frame.terms.items() if view.reused]
    words = [f"{frame.samples} samples" if frame.samples else "refining"]
    if frame.first_s is not None:
        words.append(f"first picture after {frame.first_s:.2f} s")
    words.append(f"kept: {', '.join(reused)}" if reused else "nothing kept from before")
    return " · ".join([*words, "done" if frame.at_rest else "refining"])


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]], caption: str) -> str:
    def line(tag: str, cells: tuple[str, ...]) -> str:
        return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    body = "".join(line("td", row) for row in rows)
    return (
        f"<table class=figures aria-label='{escape(caption)}'><thead>{line('th', head)}</thead>"
        f"<tbody>{body}</tbody></table>"
    )


def _terms_table(frame: Frame) -> str:
    rows = [
        (
            term,
            _variant(frame.state, term),
            str(view.samples),
            f"{view.seconds:.2f}",
            view.reason if view.status == "skipped" else view.status + (", kept from before" if view.reused else ""),
        )
        for term, view in frame.terms.items()
    ]
    return _table(("term", "variant", "samples", "seconds", ""), rows, "Terms")


def _variant(state: State, term: Term) -> str:
    """Name of a term's estimator, and where `auto` took it, that it did."""
    name = state.variant(term).name
    return name if state.variants[term] == name else f"{name}, by {state.variants[term]}"


def _plan_table(frame: Frame) -> str:
    state = frame.state
    variants: dict[Term, Variant] = {term: state.variant(term) for term in TERMS}
    steps = plan(state.scene, variants, chain=CHAIN, samples=state.samples)
    rows = []
    for step in steps:
        saved = ", ".join(f"{count:,} {name}" for name, count in step.saved.items())
        seconds = f"{frame.terms[step.term].seconds:.2f}" if step.work.startswith("kernel") and step.runs else ""
        rows.append(
            (
                step.term,
                step.work,
                step.kind,
                step.reason,
                f"at most {saved}" if step.at_most and saved else saved,
                seconds,
            )
        )
    return _table(("term", "work", "", "why", "saved", "seconds"), rows, "Plan")


def _verdict_table(view: TruthView) -> str:
    rows = [
        (row.term, row.word, DASH if math.isnan(row.bias) else interval(row.bias, row.low, row.high), f"{row.rmse:.3g}")
        for row in view.rows
    ]
    words = "".join(f"<p>{escape(row.term)}: {escape(row.sentence)}</p>" for row in view.rows if row.sentence)
    said = f"<details class=words><summary>in words</summary>{words}</details>" if words else ""
    return _table(("term", "verdict", "bias [90 %]", "RMSE"), rows, "Verdicts") + said
