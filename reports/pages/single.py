"""A report as one file to mail: every page with its styles, scripts, pictures and pixels inside.

The files travel as they are, by their path, in one JSON; a script shows each page in a frame and hands it, as
`blob:` addresses, what it asks for. Downloads (EXR, NetCDF, JSON) stay outside.
"""

import base64
from pathlib import Path

import jinja2

from termwise.reports.pages.environment import page_environment, render_page

_TEXT = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}


def write(run: Path) -> Path:
    """Write `report.html` beside the pages of a run, of their content; returns its path.

    Raises
    ------
    FileNotFoundError : if the run has no `index.html`.
    """
    if not (run / "index.html").is_file():
        raise FileNotFoundError(f"{run / 'index.html'}: no such file: allowed is a run whose pages are written")
    target = run / "report.html"
    found = [*run.glob("*.html"), *run.glob("*.css"), *run.glob("*.js"), *run.glob("scenes/*.html")]
    found += [*run.glob("data/*/*.js"), *run.glob("pictures/*/*.png")]
    files = {}
    for path in sorted(found):
        if path != target:
            text = path.suffix in _TEXT
            content = path.read_text("utf-8") if text else base64.b64encode(path.read_bytes()).decode("ascii")
            files[path.relative_to(run).as_posix()] = {
                "type": _TEXT.get(path.suffix, "image/png"),
                "text" if text else "base64": content,
            }
    environment: jinja2.Environment = page_environment()
    render_page(environment, "single.html.j2", target, files=files)
    return target
