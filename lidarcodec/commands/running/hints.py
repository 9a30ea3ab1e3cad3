"""Hints for options that do not exist: which one was meant, or how a setting is written."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

MEANT: Final = {
    "format": "--as FORMAT",
    "output": "OUT, without an option",
    "bitrate": "--set target_kbps=VALUE",
    "target": "--set target_kbps=VALUE",
    "error": "--set max_error_m=VALUE",
}
"""Names that people try, and what they mean here."""
_LIMITS: Final = {"greater than or equal to": "at least", "less than or equal to": "at most"}


def hint_for(error: Any, words: Sequence[str]) -> str:
    """What to write instead of what the command line refused; an empty text if that is not known.

    words: the arguments
    """
    known = {name for one in getattr(getattr(error, "ctx", None), "command", _NOTHING).params for name in one.opts}
    settable = "--set" in known
    for before, word in pairwise(words):
        if settable and before == "--set" and "=" not in word:
            return f"write --set {word}=VALUE"
    name = str(getattr(error, "option_name", "")).lstrip("-").replace("-", "_")
    if name == "link" and settable:
        return _of_link(words)
    if not name:
        return ""
    meant = MEANT.get(name, "")
    if (meant.startswith("--") and meant.split()[0] in known) or meant.startswith("OUT"):
        return f"write {meant}"
    return _setting(name) if settable else ""


def in_plain_words(text: str) -> str:
    """What typer says of a number out of its limits, in the words of our own errors; any other text as it is.

    >>> in_plain_words("Invalid value for '--frames': Input should be greater than or equal to 1")
    "Invalid value for '--frames': must be at least 1"
    """
    for theirs, ours in _LIMITS.items():
        text = text.replace(f"Input should be {theirs} ", f"must be {ours} ")
    return text


def _of_link(words: Sequence[str]) -> str:
    """What a live stream's `--link` sets, as settings of a file."""
    from lidarcodec.ratecontrol.presets import PRESETS

    given = [word.partition("=")[2] for word in words if word.startswith("--link=")]
    given += [word for before, word in pairwise(words) if before == "--link"]
    found = PRESETS.get(given[0]) if given else None
    kbps = "VALUE" if found is None else f"{found.target_kbps:g}" if found.target_kbps else ""
    target = f" --set target_kbps={kbps}" * bool(kbps)
    return f"--link is for live streams, and here it is --codec auto{target}"


def _setting(name: str) -> str:
    from lidarcodec.settings import StreamSettings

    fields = [field for field in StreamSettings.model_fields if field.startswith(name)]
    return f"write --set {fields[0]}=VALUE" if len(name) > 2 and fields else ""


class _Nothing:
    params: tuple[Any, ...] = ()


_NOTHING: Final = _Nothing()
