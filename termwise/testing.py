"""Renderers in tests: `assert_equivalent` for one comparison; the pytest fixture of that name for all of a session.

The function judges at once, at a level of its own. The fixture (`termwise.pytest_plugin`) judges at the end, all
comparisons of the session under one level, and writes one report of them.
"""

import itertools
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from termwise.reports.judging.judge import Judgement

_written: set[str] = set()


def assert_equivalent(
    images: Any,
    reference: Any,
    *,
    margin: float = 0.01,
    level: float = 0.05,
    out: str | Path = "out/assert_equivalent",
    **options: Any,
) -> "Judgement":
    """Assert that images are equivalent to a reference; a failure says why, and where its page is.

    Noise does not pass: UNDERPOWERED fails as BIASED does.

    Parameters
    ----------
    images, reference : (K, H, W, 3) and (R, H, W, 3) floating, or all else that `termwise.judge` takes
        Replicates of equal settings and different seeds, linear radiance in one unit.
    margin : relative bias of a mean that is equivalent to none.
    level : chance of any false BIASED in this comparison.
    out : where the page of a failure goes, in a folder named after the test.
    options : of `termwise.judge`: `objects`, `mask`, `exact`, `noiseless`, `allow_negative`, `samples`, ...

    Returns
    -------
    The `Judgement`, EQUIVALENT.

    Raises
    ------
    AssertionError : the verdict is another one; its text is the verdict in plain words, its sentence, hints, warnings,
        and the path of the page.
    ValueError : the images cannot be compared.
    """
    import termwise

    __tracebackhide__ = True
    judgement = termwise.judge(images, reference, margin=margin, level=level, **options)
    if judgement.verdict == "EQUIVALENT":
        return judgement
    page = judgement.save(_fresh(Path(out)))
    raise AssertionError(explained(judgement, page))


def explained(judgement: "Judgement", page: Path) -> str:
    """The text of a failure."""
    from termwise.reports.judging.gates import words

    return "\n".join([judgement.headline, words(judgement), f"report: {page.resolve()}"])


def current_test() -> str:
    """The name of the test that pytest runs, fit for a folder; empty outside of one."""
    running = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0]
    return re.sub(r"[^\w.\-]+", "-", running.rpartition("/")[2]).strip("-")


def _fresh(out: Path) -> Path:
    """A folder of the test's name that this process has not written to."""
    name = current_test() or "comparison"
    names = itertools.chain([name], (f"{name}-{number}" for number in itertools.count(2)))
    folder = next(each for each in (out / name for name in names) if str(each) not in _written)
    _written.add(str(folder))
    return folder
