"""Opens the page in a browser, if there is one with a window."""

from __future__ import annotations

import os
import sys
import threading
import webbrowser

SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def browser() -> webbrowser.BaseBrowser | None:
    """The one that the variable BROWSER names, otherwise one with a window; None if there is none."""
    wanted = os.environ.get("BROWSER")
    if not wanted and sys.platform == "linux" and not any(map(os.environ.get, SCREENS)):
        return None
    try:
        found = webbrowser.get()
    except webbrowser.Error:
        return None
    in_the_terminal = type(found) is webbrowser.GenericBrowser
    return found if wanted or not in_the_terminal else None


def show(address: str) -> bool:
    """Open the page, without waiting for it. False if there is no browser."""
    found = browser()
    if found is None:
        return False
    threading.Thread(target=found.open, args=(address,), name="lidarcodec browser", daemon=True).start()
    return True
