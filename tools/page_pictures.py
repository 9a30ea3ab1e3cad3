"""Takes the pictures of the page that docs/page.md and the README show.

    python tools/page_pictures.py

Starts `lidarcodec demo`, opens its page in a headless Chromium (Playwright; CHROMIUM names another program), and writes
docs/page.jpg, page-light.jpg, page-narrow.jpg, page-missed.jpg and compare.jpg.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
from PIL import Image
from playwright.sync_api import sync_playwright

DOCS = Path(__file__).resolve().parent.parent / "docs"
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WINDOW, PHONE = (1440, 900), (360, 779)
SETTLE_MS = 6000
"""After a change: the stream has new settings, and the page has drawn a few frames of it."""


@contextmanager
def demonstration() -> Iterator[str]:
    """A vehicle, a server and the page; its address."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "lidarcodec", "demo", "--no-browser", "--seconds", "600"]
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            found = next(filter(None, (re.search(r"http://\S+", line) for line in process.stdout)))
            yield found[0]
        finally:
            process.terminate()
            process.wait()


def main() -> None:
    """Take all pictures."""
    program = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    with demonstration() as url, sync_playwright() as playwright:
        (stream,) = httpx.get(f"{url}/api/v1/streams").json()
        settings = f"{url}/api/v1/streams/{stream['vehicle']}/{stream['sensor']}/settings"
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)

        def opened(size: tuple[int, int], scheme: str) -> Any:
            page = browser.new_page(viewport=dict(zip(("width", "height"), size, strict=True)), color_scheme=scheme)
            page.goto(url)
            page.wait_for_timeout(SETTLE_MS)
            return page

        def take(page: Any, name: str, width: int) -> None:
            with Image.open(io.BytesIO(page.screenshot())) as whole:
                size = width, round(whole.height * width / whole.width)
                whole.convert("RGB").resize(size, Image.Resampling.LANCZOS).save(DOCS / name, quality=85)

        def change(page: Any, **changes: Any) -> None:
            httpx.patch(settings, json=changes, timeout=30.0).raise_for_status()
            page.wait_for_timeout(SETTLE_MS)

        for size, scheme, name, width in (
            (WINDOW, "light", "page-light.jpg", 900),
            (PHONE, "dark", "page-narrow.jpg", 300),
        ):
            page = opened(size, scheme)
            take(page, name, width)
            page.close()  # each page that draws in software takes a processor from the others
        page = opened(WINDOW, "dark")
        take(page, "page.jpg", 1200)
        change(page, codec="jpeg")
        page.get_by_label("Compare").check()
        page.wait_for_timeout(SETTLE_MS)
        take(page, "compare.jpg", 1280)
        page.get_by_label("Compare").uncheck()
        change(page, codec="pcodec", target_kbps=300, max_error_m=0, intensity="lossless", reduction="all")
        page.wait_for_timeout(2 * SETTLE_MS)
        take(page, "page-missed.jpg", 900)
        browser.close()


if __name__ == "__main__":
    main()
