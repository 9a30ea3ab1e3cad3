"""A headless Chromium for tests: the machine's own, driven by the package `playwright`. Skipped by name without them.

Browser and driver live as long as a module's tests, because the driver keeps an event loop in this thread, which tests
of coroutines in other modules would find in their way. Modules here have no coroutines.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
LIMIT_MS = 60_000
EMPTY_S = 10.0
TEST_S = 300
"""Of a test with its page: a busy machine draws slowly."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give tests of this folder more time."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker(pytest.mark.timeout(TEST_S))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser that runs; `playwright.sync_api.Browser`."""
    driver = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs chromium")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home, driver.sync_playwright() as playwright:
        try:
            started = playwright.chromium.launch(
                executable_path=program,
                headless=True,
                args=FLAGS,
                env={"HOME": home, "PATH": "/usr/bin:/bin"},
                timeout=LIMIT_MS,
            )
            took_s = _open_nothing(started)
        except driver.TimeoutError:
            took_s = float("inf")
        if took_s > EMPTY_S:
            pytest.skip(f"chromium takes {took_s:.0f} s for an empty page here: this machine is too busy to draw")
        try:
            yield started
        finally:
            started.close()


def _open_nothing(browser: Any) -> float:
    """Seconds for an empty page. Where that takes long, a page says more of the machine than of itself."""
    start = time.monotonic()
    page = browser.new_page()
    page.goto("about:blank", timeout=LIMIT_MS)
    page.close()
    return time.monotonic() - start


@pytest.fixture
def page_of(browser: Any) -> Iterator[Callable[..., Any]]:
    """Function from an address to an open page of its own context; options are those of `new_context`.

    `page.complaints` collects what the page wrote as errors or warnings on the console, and what it did not catch. A
    test fails at its end when there is any that it did not take out; the driver's remarks on reading pictures back are
    none of the page's. The page's policy forbids `eval`, and with it
    `page.wait_for_function`: wait with `expect`, or poll `page.evaluate`.
    """
    pages = []

    def open_page(url: str, **options: Any) -> Any:
        context = browser.new_context(**options)
        context.set_default_timeout(LIMIT_MS)
        page = context.new_page()
        page.complaints = []
        page.on("console", lambda said: _complains(said) and page.complaints.append(said.text))
        page.on("pageerror", lambda error: page.complaints.append(str(error)))
        pages.append(page)
        page.goto(url)
        return page

    yield open_page
    complaints = [text for page in pages for text in page.complaints]
    for page in pages:
        page.context.close()
    assert complaints == []


def _complains(said: Any) -> bool:
    """Whether something on the console is a complaint of the page."""
    return said.type in ("error", "warning") and "GL Driver Message" not in said.text
