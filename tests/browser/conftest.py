"""Chromium for the browser tests. TERMWISE_BROWSER=required makes a missing one a failure, where it is a skip else."""

import os
import shutil
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import Browser, BrowserContext, expect, sync_playwright

REQUIRED = os.environ.get("TERMWISE_BROWSER") == "required"
# Everything is waited for until it is there; what has not come by then never will, however busy the machine.
WAIT_S = 300
expect.set_options(timeout=1000 * WAIT_S)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium of the system."""
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        reason = "no Chromium on this machine: on Debian, apt-get install chromium"
        if REQUIRED:
            pytest.fail(reason)
        pytest.skip(reason)
    with sync_playwright() as playwright:
        # Its sandbox needs user namespaces, which containers refuse; the pages are our own.
        found = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        yield found
        found.close()


@pytest.fixture
def new_context(browser: Browser) -> Iterator[Callable[..., BrowserContext]]:
    """Makes users of the browser, patient ones; all are gone in the end: a page left open would go on rendering."""
    made: list[BrowserContext] = []

    def new(**options: object) -> BrowserContext:
        made.append(browser.new_context(**options))  # type: ignore[arg-type]
        made[-1].set_default_timeout(1000 * WAIT_S)
        return made[-1]

    yield new
    for context in made:
        context.close()
