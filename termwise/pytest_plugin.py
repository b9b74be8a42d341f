"""The pytest plugin: a fixture that collects the comparisons of a session, judged at its end under one level.

How many tests a session makes is known only when it ends, and the level of each depends on it: so `assert_equivalent`
measures at once and judges later. A comparison that fails is then reported as an error of the test that made it, and
the session fails. Of pytest-xdist's workers, each measures, and the session that started them judges.
"""

import base64
import itertools
import pickle
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

_KEY = "termwise"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where the report goes, and the level."""
    group = parser.getgroup("termwise", "images of renderers, judged against references")
    group.addoption(
        "--termwise-out", default="out/pytest", metavar="FOLDER", help="report of all comparisons (default: out/pytest)"
    )
    parser.addini("termwise_level", "chance of any false BIASED in a session (default: 0.05)", default="0.05")
    parser.addini(
        "termwise_margin", "relative bias of a mean that is equivalent to none (default: 0.01)", default="0.01"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Begin to collect."""
    config.pluginmanager.register(_Session(config), "termwise-session")


class _Session:
    """The comparisons of a session: what was measured, by the test that made it."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.out = Path(config.rootpath, str(config.getoption("--termwise-out")))
        self.measured: list[tuple[str, str, str, float, Any]] = []
        self.lines: list[str] = []

    @property
    def worker(self) -> str:
        """Of pytest-xdist; empty elsewhere."""
        return getattr(self.config, "workerinput", {}).get("workerid", "")

    def number(self, ini: str) -> float:
        """A number of the configuration."""
        try:
            return float(self.config.getini(ini))
        except ValueError:
            raise pytest.UsageError(f"{ini} = {self.config.getini(ini)!r}: allowed is a number") from None

    def add(self, test: str, name: str, images: Any, reference: Any, margin: float | None, options: Any) -> None:
        """Measure a comparison, and keep its images for the report."""
        from termwise.reports.judging.folder import keep
        from termwise.reports.judging.judge import measure
        from termwise.reports.judging.suite import slug

        margin = self.number("termwise_margin") if margin is None else margin
        taken = {each for _, each, *_ in self.measured}
        numbered = (f"{name} {number}" for number in itertools.count(2))
        unique = next(each for each in itertools.chain([name], numbered) if each not in taken)
        # Another worker may have a test of this name, in another file: both write at once.
        place = f"{slug(unique)}-{zlib.crc32(f'{test} {unique}'.encode()):08x}"
        found = measure(images, reference, margin=margin, level=self.number("termwise_level"), **options)
        keep(self.out / place, found)
        self.measured.append((test, unique, place, margin, found.without_images()))

    @pytest.hookimpl(tryfirst=True)  # reports of the session are written later
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Judge all that was measured; of a worker, hand it on."""
        if self.worker:
            self.config.workeroutput[_KEY] = base64.b64encode(pickle.dumps(self.measured)).decode()  # type: ignore[attr-defined]
        elif self.measured:
            self.judge(session)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take over what a worker of pytest-xdist measured."""
        if handed := getattr(node, "workeroutput", {}).get(_KEY):
            self.measured += pickle.loads(base64.b64decode(handed))

    def judge(self, session: pytest.Session) -> None:
        """One level over all comparisons, one report, and an error for each that is not EQUIVALENT."""
        from termwise.reports.judging.suite import decide_all
        from termwise.testing import explained

        self.measured.sort(key=lambda each: (each[1], each[0]))
        outcomes = decide_all(
            [(name, place, found) for _, name, place, _, found in self.measured],
            self.out,
            margins=[margin for *_, margin, _ in self.measured],
            level=self.number("termwise_level"),
            command="pytest",
        )
        failed = 0
        for (test, name, *_), outcome in zip(self.measured, outcomes, strict=True):
            if outcome.judgement.verdict == "EQUIVALENT":
                continue
            failed += 1
            text = f"{name}: {explained(outcome.judgement, outcome.page)}"
            report = pytest.TestReport(test, (test.partition("::")[0], 0, test), {}, "failed", text, "teardown")
            session.ihook.pytest_runtest_logreport(report=report)
        if failed and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
        passed = len(outcomes) - failed
        self.lines = [f"{passed} of {len(outcomes)} comparisons EQUIVALENT: {self.out / 'index.html'}"]

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Where the report is."""
        if self.lines:
            terminalreporter.section("termwise")
            for line in self.lines:
                terminalreporter.line(line)


@pytest.fixture
def assert_equivalent(request: pytest.FixtureRequest) -> Callable[..., None]:
    """A function: compare replicates with those of a reference, judged with all others when the session ends.

    `assert_equivalent(images, reference, *, name=None, margin=None, **options)` takes what
    `termwise.testing.assert_equivalent` takes, but the level, which is that of the session: `termwise_level` of
    pytest's configuration. `name` is that of the comparison in the report, by default the test's.
    """
    session = request.config.pluginmanager.get_plugin("termwise-session")
    assert isinstance(session, _Session)

    def compare(
        images: Any, reference: Any, *, name: str | None = None, margin: float | None = None, **options: Any
    ) -> None:
        session.add(request.node.nodeid, name or request.node.name, images, reference, margin, options)

    return compare
