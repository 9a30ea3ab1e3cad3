"""A headless Chromium for tests: the machine's own, driven by the package `playwright`. Skipped by name without them.

All tests of this folder share one browser, its page, one vehicle and, but for those that need tokens, one server: a
core is busy with drawing, and none is to be left for a second system beside it. So they are one group for `pytest -n`,
too. Browser and driver end with this folder, because the driver keeps an event loop in this thread, which tests of
coroutines elsewhere would find in their way. Modules here have no coroutines.

They run first: so `pytest -n` gives them to one process as they stand. Where it does not, processes take turns.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser.system import System, system

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
VIEWPORT = {"width": 1280, "height": 720}
EMPTY_S = 10.0
TEST_S = 300
"""Of a test with its page: a busy machine draws slowly."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give tests of this folder more time, and have them run first, in one process."""
    folder = str(Path(__file__).parent) + os.sep
    here = [item for item in items if str(item.path).startswith(folder)]  # of ten thousand, so no path is taken apart
    for item in here:
        item.add_marker(pytest.mark.timeout(TEST_S))
        item.add_marker(pytest.mark.xdist_group("browser"))
    chosen = set(here)
    items[:] = here + [item for item in items if item not in chosen]


@pytest.fixture(scope="package")
def turn(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """No other process of this run has a browser or its system."""
    base = tmp_path_factory.getbasetemp()
    folder = base if "PYTEST_XDIST_WORKER" not in os.environ else base.parent
    with (folder / "browser.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture(scope="package")
def browser(turn: None) -> Iterator[Any]:
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


@pytest.fixture(scope="package")
def running(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    """A server that needs no token. The browser is there before it: one that starts beside a vehicle takes longer."""
    with system(tmp_path_factory.mktemp("fleet")) as made:
        yield made


@pytest.fixture
def fleet(running: System) -> System:
    """The server with its vehicle car-7, which drives."""
    running.start_vehicle()
    return running


@pytest.fixture(scope="package")
def tab(browser: Any) -> Any:
    """The one page of all tests: a process for each would start for longer than most of them take."""
    context = browser.new_context(viewport=VIEWPORT)
    context.set_default_timeout(LIMIT_MS)
    page = context.new_page()
    page.complaints = []
    page.on("console", lambda said: _complains(said) and page.complaints.append(said.text))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    return page


@pytest.fixture
def page_of(tab: Any) -> Iterator[Callable[..., Any]]:
    """Function from an address to the page there, loaded anew, with nothing kept of what a test before it did.

    viewport, color_scheme: as for `new_context`

    `page.complaints` collects what the page wrote as errors or warnings on the console, and what it did not catch. A
    test fails at its end when there is any that it did not take out; the driver's remarks on reading pictures back are
    none of the page's. The page's policy forbids `eval`, and with it
    `page.wait_for_function`: wait with `expect`, or poll `page.evaluate`.
    """

    def open_page(url: str, viewport: dict[str, int] = VIEWPORT, color_scheme: str = "light") -> Any:
        tab.set_viewport_size(viewport)
        tab.emulate_media(color_scheme=color_scheme)
        tab.complaints.clear()
        tab.goto(url)
        return tab

    yield open_page
    complaints = list(tab.complaints)
    if tab.url.startswith("http"):
        tab.evaluate("localStorage.clear(), sessionStorage.clear()")
    tab.goto("about:blank")
    assert complaints == []


def _complains(said: Any) -> bool:
    """Whether something on the console is a complaint of the page."""
    return said.type in ("error", "warning") and "GL Driver Message" not in said.text
