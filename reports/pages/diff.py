"""What changed between two runs as a page: what `reports.results.diff.diff` found -> `index.html` and `diff.json`."""

from pathlib import Path
from typing import Any

from termwise.reports.pages.environment import WORDS, copy_static, page_environment, render_page
from termwise.reports.results import schema as stored
from termwise.reports.results.diff import said


def write(found: dict[str, Any], folder: Path) -> Path:
    """Write the page and the numbers on it; returns the `index.html`.

    Parameters
    ----------
    found : of `reports.results.diff.diff`, with the `runs` that were compared and the `command`.
    folder : made if missing.
    """
    stored.write(folder / "diff.json", found)
    index = folder / "index.html"
    values = {"found": found, "words": WORDS, "said": said, "page": "diff"}
    render_page(page_environment(), "diff.html.j2", index, root="", **values)
    copy_static(folder, charts=False)
    return index
