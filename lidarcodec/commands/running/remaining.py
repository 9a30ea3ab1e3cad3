"""The error of a stopped command: what it wrote, the command for the rest, and the command that joins both."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Final

from lidarcodec.commands.running.stopping import StoppedError
from lidarcodec.files.whole import beside

JOINED: Final = (".mcap", ".pcap")
"""Endings of the files that `join` accepts."""
_COUNTS: Final = ("--skip", "--frames")
_given: list[str] = []


def remember(words: Sequence[str]) -> None:
    """Remember the words of the command that begins."""
    _given[:] = words


def stopped(
    out: Path, kept: Path | None, done: int, *, skip: int = 0, frames: int | None = None, live: bool = False
) -> StoppedError:
    """The error to raise.

    kept: file with the first `done` frames after `skip`;  frames: number of wanted frames;  live: whether the source is
    live, so that it cannot give the rest
    """
    if kept is None:
        return StoppedError(f"stopped before the first frame: {out} was not written")
    if live:
        return StoppedError(f"stopped: {done} of {frames} frames are kept in {kept}")
    rest = _free(out)
    left = None if frames is None else frames - done
    lines = [
        f"stopped: {done} frames are kept in {kept}; to get the others:",
        f"  the rest:  {_quoted(rest_words(_given, out, rest, skip + done, left))}",
    ]
    if out.suffix.lower() in JOINED:
        force = ["--force"] if os.path.lexists(out) else []
        lines.append(f"  then both: {_quoted(['join', *force, _word(kept), _word(rest), _word(out)])}")
    return StoppedError("\n".join(lines))


def rest_words(words: Sequence[str], out: Path, rest: Path, skip: int, frames: int | None) -> list[str]:
    """The words of a command that writes all frames after the first `skip` to `rest`.

    >>> words = ["encode", "a.pcap", "out.mcap", "--frames=9", "--skip", "1"]
    >>> rest_words(words, Path("out.mcap"), Path("rest.mcap"), 5, 5)
    ['encode', '--skip', '5', '--frames', '5', 'a.pcap', 'rest.mcap']
    """
    kept: list[str] = []
    value_of = ""
    for word in words:
        if value_of:
            value_of = ""
        elif word in _COUNTS:
            value_of = word
        elif not word.startswith(tuple(f"{name}=" for name in _COUNTS)):
            kept.append(word)
    places = [at for at, word in enumerate(kept) if Path(word) == out]
    if places:
        kept[places[-1]] = _word(rest)
    counts = ["--skip", str(skip), *(["--frames", str(frames)] if frames is not None else [])]
    return [*kept[:1], *counts, *kept[1:]]


def _word(path: Path) -> str:
    """A path as a word of a command line. It must not look like an option."""
    return f"./{path}" if str(path).startswith("-") else str(path)


def _free(out: Path) -> Path:
    """A path for the rest that does not exist yet."""
    for number in count(1):
        name = beside(out, f".rest{'' if number == 1 else f'-{number}'}")
        if not os.path.lexists(name):
            break
    return name


def _quoted(words: Sequence[str]) -> str:
    return shlex.join(["lidarcodec", *words])
