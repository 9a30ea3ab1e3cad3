"""Runs a command and ends it: exit codes, errors in one line, standard streams, the end of the process."""

from __future__ import annotations

import contextlib
import errno
import io
import logging
import os
import signal
import sys
import traceback
from typing import NoReturn

import typer

from lidarcodec.commands.running.ending import DONE, FAILED, INTERRUPTED, WRONG_USAGE, is_live
from lidarcodec.commands.running.hints import hint_for, in_plain_words
from lidarcodec.commands.running.open_files import raise_limit
from lidarcodec.commands.running.options import command_line
from lidarcodec.commands.running.remaining import remember
from lidarcodec.commands.running.stopping import Interrupter, StoppedError, ignore_signals, signal_that_came
from lidarcodec.commands.running.zenoh_log import zenoh_log
from lidarcodec.errors import LidarCodecError, MissingExtraError, SettingsError, UnknownNameError
from lidarcodec.files.whole import drop_all
from lidarcodec.untrusted.text import PrintableLog, one_line

_BY_TYPER = 130
"""typer's exit code for a KeyboardInterrupt."""
_GO_ON = ("annotate", "train", "fetch")
"""Commands that save their work while they run."""
_USAGE = (SettingsError, UnknownNameError, MissingExtraError)
"""Usage errors: the user must change the command, or install an extra."""


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, OSError) and error.errno == errno.ENOSPC and error.filename is None:
        text = f"{error.strerror}: make room or write elsewhere"
    elif isinstance(error, OSError) and error.strerror and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    return text


def _complain(error: BaseException, words: list[str]) -> int:
    """Print an error as one line. Returns its exit code. words: the arguments"""
    if isinstance(error, typer.TyperException):
        context = getattr(error, "ctx", None)
        path = context.command_path if context else "lidarcodec"
        if context and error.message == context.get_help():  # a group of commands, and none of them was named
            sys.stderr.write(f"{error.message}\n")
            return WRONG_USAGE
        hint = hint_for(error, words)
        said = error.message if hint else error.format_message()  # other options are no better than the hint
        text = in_plain_words(" ".join(said.split())).rstrip(".") + (f": {hint}" if hint else "")
        sys.stderr.write(f"{path}: {one_line(text)} (see: {path} --help)\n")
        return WRONG_USAGE
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and "start new thread" in str(error)):
        sys.stderr.write("lidarcodec: not enough memory: close other programs, or process smaller parts\n")
        return FAILED
    known = isinstance(error, LidarCodecError | OSError)
    text = (
        _one_line(error)
        if known
        else f"unexpected {type(error).__name__}: {_one_line(error)}; for details, add --debug"
    )
    sys.stderr.write(f"lidarcodec: {one_line(text)}\n")
    return WRONG_USAGE if isinstance(error, _USAGE) else FAILED


def _flush() -> None:
    """Flush standard output and standard error. A stream is None if the caller closed it (`>&-`)."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()


def _unprinted() -> str | None:
    """Flush standard output. Returns the reason if that fails, None otherwise. Raises BrokenPipeError."""
    try:
        _flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        with contextlib.suppress(OSError):  # otherwise the interpreter tries again at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error.strerror or str(error)
    return None


def run(app: typer.Typer, arguments: list[str]) -> int:
    """Run one command. Returns its exit code."""
    debug = "--debug" in arguments or os.environ.get("LIDARCODEC_DEBUG", "0") not in ("", "0")
    given = [word for word in arguments if word != "--debug"]
    handler = logging.StreamHandler()
    handler.setFormatter(PrintableLog("lidarcodec: warning: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    Interrupter().install(hangup=not is_live(given))
    remember(given)
    if is_live(given):
        raise_limit()
    if not is_live(given) and isinstance(sys.stdout, io.TextIOWrapper):
        # Even with PYTHONUNBUFFERED a failed print must not end a command halfway. The same holds for names with
        # characters that standard output cannot encode.
        sys.stdout.reconfigure(write_through=False)
        if sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="backslashreplace")
    code = None
    try:
        code = command_line(app, given)(given, prog_name="lidarcodec", standalone_mode=False, obj=app)
        unprinted = _unprinted()
    except KeyboardInterrupt:
        return _stopped(given)
    except StoppedError as stopped:
        return _stopped(given, str(stopped))
    except (BrokenPipeError, SystemExit):  # typer ends the process when it sees a broken pipe
        # The reader has closed our output. The interpreter flushes once more at exit, which must not fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return int(code or DONE) if signal_that_came() is None else _stopped(given)
    except Exception as error:
        if not debug:
            return _complain(error, given)
        traceback.print_exception(error)
        return WRONG_USAGE if isinstance(error, (*_USAGE, typer.TyperException)) else FAILED
    finally:
        drop_all()
    if code == _BY_TYPER:
        return _stopped(given)
    if unprinted is not None:
        # As in cp, mv and tee: a script that saves the printed output must learn that it is lost.
        lost = "the printed output is lost, but all output files are complete"
        sys.stderr.write(f"lidarcodec: cannot write to standard output: {unprinted}: {lost}\n")
    return int(code or (DONE if unprinted is None else FAILED))


def _stopped(words: list[str], said: str = "") -> int:
    """Print that a signal ended the command. Returns the exit code."""
    ignore_signals()
    drop_all()
    if is_live(words):
        return DONE
    if not said:
        goes_on = any(word in _GO_ON for word in words[:1])
        said = "stopped: run the same command again to continue" if goes_on else "stopped before it was finished"
    sys.stderr.write(f"lidarcodec: {said}\n")
    return INTERRUPTED + (signal_that_came() or signal.SIGINT)


def keep_standard_output() -> None:
    """Keep standard output for our own output: the network library writes its log to descriptor 1 directly."""
    _flush()
    ours = os.dup(1)
    zenoh_log.begin()
    sys.stdout = os.fdopen(ours, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)
    sys.stdout.reconfigure(line_buffering=sys.stdout.isatty())


def _open_standard_streams() -> None:
    """Open standard streams that the caller closed (`>&-`). Otherwise the first socket would become standard output."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", closefd=False)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", closefd=False)


def main(app: typer.Typer) -> NoReturn:
    """Run the command of the command line and end the process."""
    _open_standard_streams()
    code = run(app, sys.argv[1:])
    ignore_signals()
    with contextlib.suppress(OSError):
        _flush()
    if "zenoh" in sys.modules:
        # Zenoh's threads live a moment longer than a closed session. If one of them calls the interpreter while
        # it shuts down, the process aborts ("FATAL: exception not rethrown"). So skip that shutdown: everything of
        # ours is closed.
        zenoh_log.end()
        os._exit(code)
    sys.exit(code)
