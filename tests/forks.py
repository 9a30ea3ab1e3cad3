"""Python programs that begin as copies of a process that has imported this package already.

A command of the command line imports for half a second of processor time, and most tests of one let it work for less.
So the first of them in a process of tests starts another one, which imports what commands need and then forks for each
program that is asked for: the same code in a process of its own, as `python -m` starts it, but without the imports, and
without freeing them at the end. It has one thread only. It ends with the process of the tests, and the programs with
it, however that one ended. What depends on the start itself, on what is imported, or on how Python frees it, is to be
tested with `subprocess`.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parent.parent
READ_ONCE: Final = ("PYTHON", "LD_", "LC_", "LANG", "MALLOC_", "OPENBLAS_", "OMP_")
"""Variables that a process reads only once, when it starts or is imported into."""
PACKAGES: Final = ("lidarcodec.commands", "lidarcodec.codecs", "lidarcodec.sensors", "lidarcodec.sources")
SERVING: Final = ("serve", "demo", "token")
LONGEST: Final = 1 << 18
"""Bytes of a request; Linux takes as much at once."""
LAST_S: Final = 5.0
"""For programs to end by themselves, when those who asked for them are gone."""
PR_SET_PDEATHSIG: Final = 1


class Process(subprocess.Popen):
    """A process. Forked where the command is `python -m MODULE WORDS` and nothing asks for a start of its own."""

    _channel: socket.socket | None = None

    def _execute_child(self, args, executable, preexec_fn, close_fds, pass_fds, cwd, env, *rest):
        _, _, shell, p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite, restore_signals, *identity = rest
        plain = close_fds and restore_signals and not (executable or preexec_fn or pass_fds or shell)
        plain = plain and all(value in (None, -1, False) for value in identity)
        template = _template() if plain and _can_be_forked(args) else None
        if template is None or not template.suits(env):
            return super()._execute_child(args, executable, preexec_fn, close_fds, pass_fds, cwd, env, *rest)
        fds = [number if number >= 0 else usual for usual, number in enumerate((p2cread, c2pwrite, errwrite))]
        try:
            words = [os.fsdecode(word) for word in args[2:]]
            self.pid, self._channel = template.fork(words, os.fspath(cwd or Path.cwd()), env, fds)
            self._child_created = True
        finally:
            self._close_pipe_fds(p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite)
        return None

    def _internal_poll(self, _deadstate=None, **others):
        if self._channel is None:
            return super()._internal_poll(_deadstate=_deadstate, **others)
        self._hear(0)
        return self.returncode

    def _wait(self, timeout):
        if self._channel is None:
            return super()._wait(timeout)
        self._hear(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self.args, timeout)
        return self.returncode

    def _hear(self, timeout: float | None) -> None:
        """Wait for the end; its code is the whole of what the channel says."""
        readable = select.poll()
        with contextlib.suppress(ValueError):
            readable.register(self._channel, select.POLLIN)
            if self.returncode is None and readable.poll(None if timeout is None else 1000 * timeout):
                with self._waitpid_lock:
                    if self.returncode is None:
                        told = self._channel.recv(64)
                        self.returncode = int(told) if told else -signal.SIGKILL  # with what it was forked from
                        self._channel.close()


def _can_be_forked(words: Any) -> bool:
    return isinstance(words, list) and len(words) > 2 and words[0] == sys.executable and words[1] == "-m"


class Template:
    """The process that others are forked from.

    imports: whether it imports what commands need before it forks
    """

    def __init__(self, *, imports: bool = True) -> None:
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LONGEST)
        paths = [str(ROOT), str(ROOT / "server"), *filter(None, [os.environ.get("PYTHONPATH")])]
        added = {"PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1", "PYTHONFAULTHANDLER": "1"}
        variables = {name: value for name, value in os.environ.items() if not name.startswith("LIDARCODEC_")} | added
        self._begun_with = _read_once(variables)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.forks", str(theirs.fileno()), str(os.getpid()), str(int(imports))],
                env=variables,
                pass_fds=[theirs.fileno()],
                cwd=ROOT,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        self._asking = threading.Lock()
        self.pid = self._process.pid

    def suits(self, variables: dict[str, str] | None) -> bool:
        """Whether a process with these variables starts as this one did."""
        if variables is None:
            return True
        given, ours = _read_once(variables), _read_once(os.environ)
        return all(given.get(name) in (ours.get(name), begun) for name, begun in self._begun_with.items()) and (
            given.keys() <= self._begun_with.keys()
        )

    def fork(self, words: list[str], folder: str, variables: Any, fds: list[int]) -> tuple[int, socket.socket]:
        """A program's number, and the channel on which its exit code will come."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        asked = {"words": words, "folder": folder, "variables": dict(os.environ if variables is None else variables)}
        with theirs, self._asking:
            socket.send_fds(self._ours, [json.dumps(asked).encode()], [*fds, theirs.fileno()])
        told = ours.recv(64)
        if not told:
            raise OSError(f"the process that forks has ended: {self._process.wait(60)}")
        return int(told), ours

    def end(self) -> None:
        """It ends when nobody can ask it any more."""
        self._ours.close()
        self._process.wait(60)


def _read_once(variables: Any) -> dict[str, str]:
    return {name: value for name, value in variables.items() if name.startswith(READ_ONCE)}


_templates: list[Template] = []
_starting = threading.Lock()


def _template() -> Template | None:
    """The one of this process; None where processes have no descriptors."""
    with _starting:
        if not _templates and hasattr(os, "pidfd_open"):
            _templates.append(Template())
        return _templates[0] if _templates else None


def end() -> None:
    """End what this process began."""
    with _starting:
        while _templates:
            _templates.pop().end()


def _prepare() -> None:
    """Import what commands need, but for what is trained with, and what opens a network."""
    import_module("lidarcodec.cli")
    for package in map(import_module, PACKAGES):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            if module.name != "lidarcodec.commands.train" and not module.name.endswith("__main__"):
                with contextlib.suppress(ImportError):  # of an extra that is not installed
                    import_module(module.name)
    gc.collect()
    gc.freeze()  # no collection in a fork looks at what it has from here, and so none copies it
    assert len(list(Path("/proc/self/task").iterdir())) == 1
    assert "zenoh" not in sys.modules, "a command without it ends otherwise than one with it"


def _serve(asking: socket.socket, asker: int) -> dict[str, Any]:
    """Fork for each request of a process. Returns only in a process that was forked, with its request."""
    ends: dict[int, tuple[int, socket.socket]] = {}
    ours = os.getpid()
    its_end = os.pidfd_open(asker)  # its end of the channel may live on in processes that were forked from it
    if os.getppid() != asker:
        os._exit(0)
    events = select.poll()
    events.register(asking, select.POLLIN)
    events.register(its_end, select.POLLIN)
    while True:
        for number, _ in events.poll():
            if number in ends:
                pid, channel = ends.pop(number)
                events.unregister(number)
                os.close(number)
                code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
                with channel, contextlib.suppress(OSError):  # nobody may wait for it any more
                    channel.send(str(code).encode())
                continue
            data, fds = (b"", []) if number == its_end else socket.recv_fds(asking, LONGEST, 8)[:2]
            if not data:
                _end_all({end: pid for end, (pid, _) in ends.items()})
            request = json.loads(data)
            if any(word in SERVING for word in request["words"][1:2]):
                with contextlib.suppress(ImportError):
                    import_module("lidarcodec_server.app")
            *streams, told = fds
            pid = os.fork()
            if pid == 0:
                _end_with(ours)
                for inherited in (its_end, *ends):
                    os.close(inherited)
                for _, channel in ends.values():
                    channel.close()
                asking.close()
                os.close(told)
                for usual, given in enumerate(streams):
                    os.dup2(given, usual)
                    os.close(given)
                return request
            for given in streams:
                os.close(given)
            channel = socket.socket(fileno=told)
            channel.send(str(pid).encode())
            end = os.pidfd_open(pid)
            ends[end] = pid, channel
            events.register(end, select.POLLIN)


def _end_with(parent: int) -> None:
    """Have this process killed when the one that it was forked from ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _end_all(running: dict[int, int]) -> None:
    """Ask programs to end, since they may have started others, and end. Those that are left are killed with that.

    running: number of each program's process by a descriptor that becomes readable with its end
    """
    events = select.poll()
    for end, pid in running.items():
        os.kill(pid, signal.SIGTERM)
        events.register(end, select.POLLIN)
    limit = time.monotonic() + LAST_S
    left = len(running)
    while left and (left_s := limit - time.monotonic()) > 0:
        for end, _ in events.poll(1000 * left_s):
            events.unregister(end)
            left -= 1
    os._exit(0)


def main() -> None:
    """Import, fork when asked, and be the program that was asked for."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's reaches the tests, too
    channel, asker, imports = map(int, sys.argv[1:])
    if imports:
        _prepare()
    request = _serve(socket.socket(fileno=channel), asker)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.main_thread()._set_native_id()  # Python 3.11 leaves that of the process that it was forked from
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["variables"])
    module, *words = request["words"]
    sys.path[0] = request["folder"]
    sys.argv[1:] = words
    from runpy import run_module

    try:
        run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as end:
        if not isinstance(end.code, int | None):
            raise
        _end(end.code or 0)
    _end(0)


def _end(code: int) -> None:
    """End as Python does, but free nothing.

    What was imported is shared with the process that this one was forked from. To free it is to copy it page by page,
    which takes longer than the work of most commands.
    """
    threading._shutdown()
    atexit._run_exitfuncs()
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    os._exit(code & 0xFF)


if __name__ == "__main__":
    main()
