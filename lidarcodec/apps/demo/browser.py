"""Opens the page in a browser, if there is one with a window."""

from __future__ import annotations

import os
import sys
import threading
import webbrowser

SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def browser() -> webbrowser.BaseBrowser | None:
    """A browser with a window, or the one in the variable BROWSER; None if there is none."""
    if not os.environ.get("BROWSER") and sys.platform == "linux" and not any(map(os.environ.get, SCREENS)):
        return None
    try:
        found = webbrowser.get()
    except webbrowser.Error:
        return None
    in_the_terminal = type(found) is webbrowser.GenericBrowser and not os.environ.get("BROWSER")
    return None if in_the_terminal else found


def show(address: str) -> bool:
    """Open the page, without waiting for it. False if there is no browser."""
    found = browser()
    if found is None:
        return False
    threading.Thread(target=found.open, args=(address,), name="lidarcodec browser", daemon=True).start()
    return True
