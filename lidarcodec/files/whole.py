"""Outputs that are there whole or not at all, whatever ends the program while it writes them.

An output is written under a hidden name beside its own. It gets its own name in one step when it is whole. Nothing that
had the name is replaced unless that is asked for, and a link that stands there is never followed.

>>> import tempfile
>>> path = Path(tempfile.mkdtemp()) / "drive.txt"
>>> with whole(path) as output:
...     _ = output.beside.write_text("all of it")
...     path.exists()
False
>>> path.read_text()
'all of it'
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path
from typing import Final

from lidarcodec.errors import LidarCodecError, SettingsError, SourceError
from lidarcodec.files.leftovers import held, hidden_name, let_go, remove_leftovers, remove_made
from lidarcodec.files.renaming import exchange, rename_new, synced

logger = logging.getLogger(__name__)

_MOST_BYTES: Final = 255
"""Of a name, where the file system does not say."""
_COMPANION_BYTES: Final = 16
"""Left free in the name of a part: a calibration beside it has a longer one (`NAME_db.xml`)."""
_begun: set[Whole] = set()
"""Outputs that have neither got their names nor been dropped."""


class Whole:
    """An output in the making.

    path: the name that it is to have;  beside: where to write it: a hidden file, or an empty folder
    straight: whether `path` is a pipe or a device, which is written as it is; `beside` is `path` then
    kept: the name that it got in the end
    """

    def __init__(
        self,
        path: Path,
        *,
        force: bool = False,
        contents: re.Pattern[str] | None = None,
        private: bool = False,
        sync: bool = True,
        tidy: bool = True,
    ) -> None:
        """force: whether to take the place of what has the name;  private: whether only the owner may read it
        sync: whether it is to survive a loss of power;  tidy: whether to remove what killed programs left of it
        contents: makes it a folder; names of the files that such a folder holds, and that may be replaced

        Raises SettingsError if the name is taken, SourceError if nothing can be written there.
        """
        check_free(path, force=force, contents=contents)
        self.path = self.beside = path
        self.kept: Path | None = None
        self.straight = _straight(path)
        self._hidden: set[Path] = set()
        self._identities: dict[Path, tuple[int, int]] = {}
        self._handles: list[int] = []
        self._tidy = tidy
        self._force, self._contents, self._private, self._sync = force, contents, private, sync
        self._companions: list[tuple[Callable[[Path], Path], Path]] = []
        self._as_part = False
        _begun.add(self)
        try:
            if not self.straight:
                self.beside = self._made(path.suffix if contents is None else "", folder=contents is not None)
        except BaseException:
            self.drop()
            raise

    def companion(self, name_of: Callable[[Path], Path], suffix: str) -> Path:
        """Where to write a file that stays beside this one; `name_of` makes its name of the name that this one gets."""
        beside = self._made(suffix, folder=False)
        self._companions.append((name_of, beside))
        return beside

    def only_part(self) -> None:
        """What there is will be whole in itself, and not all that was wanted: it gets the name of a part."""
        self._as_part = True

    def keep(self) -> None:
        """Give it its name, on disk by then.

        Raises SourceError if that cannot be done, or the name was taken meanwhile.
        """
        if self.straight:
            self.kept = self.path
            return
        self._finish(self.beside)
        for _, beside in self._companions:
            self._finish(beside)
        if not self._as_part:
            self._name(self.path, self._force)
            return
        for name in part_names(self.path, folder=self._contents is not None):
            with contextlib.suppress(FileExistsError):
                self._name(name, force=False)
                return

    def drop(self) -> None:
        """Remove what has not got its name; harmless when called twice."""
        for hidden in list(self._hidden):
            remove_made(hidden)
            self._hidden.discard(hidden)
        while self._handles:
            let_go(self._handles.pop())
        _begun.discard(self)

    def _made(self, suffix: str, *, folder: bool) -> Path:
        """A new hidden file or folder that only its owner reads."""
        if self._tidy and not folder:
            remove_leftovers(self.path, suffix)
        while True:
            beside = hidden_name(self.path, suffix)
            self._hidden.add(beside)  # first: a signal may come right behind the next step
            try:
                if folder:
                    beside.mkdir(0o700)
                else:
                    os.close(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
                self._know(beside)
            except FileExistsError:
                self._hidden.discard(beside)
            except OSError as error:
                raise self._said(error) from None
            else:
                return beside

    def _know(self, beside: Path) -> None:
        """Note which file it is that is written, and have other programs see that it is."""
        self._identities[beside] = _identity(beside)
        handle = held(beside)
        self._handles += [] if handle is None else [handle]

    def _finish(self, beside: Path) -> None:
        """Have its bytes on disk, and its readers those that new files have.

        Raises SourceError if another program put something else in its place.
        """
        if _identity(beside) != self._identities[beside]:
            raise SourceError(f"{beside} was replaced by another program: {self.path} was not written")
        files = [beside]
        if beside.is_dir():
            files = [path for path in beside.iterdir() if path.is_file()] + files
        for path in files if self._sync else ():
            handle = os.open(path, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
        if not self._private:
            with contextlib.suppress(PermissionError):  # file systems without modes
                beside.chmod((0o777 if beside.is_dir() else 0o666) & ~_umask())

    def _name(self, name: Path, force: bool) -> None:
        """Give all files their names, or none of them."""
        pairs = [*((beside, name_of(name)) for name_of, beside in self._companions), (self.beside, name)]
        swapped: list[tuple[Path, Path, bool]] = []
        try:
            for beside, target in pairs:
                swapped.append((beside, target, self._take(beside, target, force)))
        except BaseException:
            for beside, target, was_there in reversed(swapped):
                with contextlib.suppress(OSError):
                    if was_there:
                        exchange(beside, target)
                    else:
                        target.rename(beside)
                    self._hidden.add(beside)
            raise
        self.kept = name
        if self._sync:
            synced(name.parent)
        for beside, target, was_there in swapped:
            if was_there:
                self._remove_old(beside, target)
        self._companions.clear()

    def _take(self, beside: Path, target: Path, force: bool) -> bool:
        """Rename; whether what had the name before is at `beside` now. Raises FileExistsError."""
        folder = beside.is_dir()
        if folder and not target.is_symlink() and target.is_dir() and not any(target.iterdir()):
            beside.rename(target)  # the system refuses if it is not empty any more
            return False
        try:
            rename_new(beside, target)
        except FileExistsError:
            if not force:
                raise
        else:
            return False
        check_free(target, force=True, contents=self._contents if folder else None)
        self._hidden.discard(beside)  # it will hold what is not ours
        try:
            if exchange(beside, target):
                return True
        except BaseException:
            self._hidden.add(beside)
            raise
        self._hidden.add(beside)
        if not folder:
            beside.replace(target)
            return False
        aside = self._made("", folder=True)
        self._hidden.discard(aside)
        target.rename(aside / target.name)
        try:
            rename_new(beside, target)
        except BaseException:
            (aside / target.name).rename(target)
            raise
        self._remove_old(aside / target.name, target)
        aside.rmdir()
        return False

    def _remove_old(self, old: Path, name: Path) -> None:
        """Remove what was replaced; of a folder only files that such an output has."""
        try:
            if old.is_symlink() or not old.is_dir():
                old.unlink()
                return
            for path in old.iterdir():
                if self._contents is not None and self._contents.fullmatch(path.name) and not path.is_dir():
                    path.unlink()
            old.rmdir()
        except OSError as error:
            logger.warning("the previous %s could not be removed and is now %s: %s", name, old, error.strerror or error)

    def _said(self, error: OSError) -> LidarCodecError:
        if isinstance(error, FileExistsError):
            taken = error.filename2 or self.path
            return SourceError(f"another program has just created {taken}, which was kept: nothing was written")
        if isinstance(error, FileNotFoundError) and not self.path.parent.exists():
            return SourceError(f"cannot write {self.path}: there is no folder {self.path.parent}")
        return SourceError(f"cannot write {self.path}: {error.strerror or error}")

    def _is_of(self, error: OSError) -> bool:
        """Whether an error is about this output, and not about something else that was read or written."""
        ours = {str(beside) for _, beside in self._companions} | {str(self.beside), str(self.path)}
        names = [str(name) for name in (error.filename, error.filename2) if name is not None]
        return not names or any(name in ours or Path(name).parent == self.beside for name in names)


@contextmanager
def whole(
    path: Path,
    *,
    force: bool = False,
    contents: re.Pattern[str] | None = None,
    private: bool = False,
    sync: bool = True,
    tidy: bool = True,
) -> Iterator[Whole]:
    """An output that gets its name at the end; nothing is left behind if that does not come. See `Whole`.

    Raises SettingsError if the name is taken, SourceError when it cannot be written.
    """
    output = Whole(path, force=force, contents=contents, private=private, sync=sync, tidy=tidy)
    try:
        yield output
        if output in _begun:  # it was not dropped
            output.keep()
    except OSError as error:
        if not output._is_of(error):
            raise
        raise output._said(error) from None
    finally:
        output.drop()


@contextmanager
def written_whole(path: Path, *, private: bool = False, sync: bool = True) -> Iterator[Path]:
    """Where to write a file that is ours to replace; it takes the place of `path` at the end.

    Raises SettingsError if that is a folder, SourceError when it cannot be written; nothing is left behind then.
    """
    with whole(path, force=True, private=private, sync=sync, tidy=False) as output:
        yield output.beside


def made_anew(beside: Path) -> None:
    """A library that opens only new files has made the file of an output anew: it is ours as the one before."""
    for output in _begun:
        if beside in output._identities:
            output._know(beside)


def drop_all() -> None:
    """Remove every output that has not got its name: the program ends."""
    for output in list(_begun):
        output.drop()


def check_free(path: Path, *, force: bool = False, contents: re.Pattern[str] | None = None) -> None:
    """Raise SettingsError if an output of this name would take the place of something that is to stay.

    force: whether files, links and outputs of the same kind may be replaced;  contents: see `Whole`
    """
    try:
        found = os.lstat(path)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:  # else that would be found when all is written
            raise SettingsError(f"the name {path.name} is too long for the file system: choose a shorter one") from None
        return
    kind = stat.S_IFMT(found.st_mode)
    if kind in (stat.S_IFIFO, stat.S_IFCHR) and contents is None:
        return
    of_system = kind == stat.S_IFLNK and re.match(
        r"/(dev|proc)($|/fd|/\d)", os.path.realpath(path.parent)
    )  # as /dev/stdout
    if of_system or kind not in (stat.S_IFREG, stat.S_IFLNK, stat.S_IFDIR):
        raise SettingsError(f"{path} is not a regular file: choose another name", "force")
    if kind == stat.S_IFDIR:
        if contents is None:
            raise SettingsError(f"{path} is a folder: give the name of a file", "force")
        entries = list(path.iterdir())
        if not entries:
            return
        foreign = next((one for one in entries if one.is_dir() or not contents.fullmatch(one.name)), None)
        if force and foreign is not None:
            raise SettingsError(
                f"{path} also holds other files ({foreign.name}): even --force does not replace such a folder", "force"
            )
        if not force:
            raise SettingsError(
                f"{path} is not empty: choose another name, or use --force to replace the folder", "force"
            )
        return
    if not force:
        raise SettingsError(f"{path} exists: choose another name, or use --force to replace it", "force")


def part_names(path: Path, *, folder: bool = False) -> Iterator[Path]:
    """Names for a part of an output, the first ones first.

    >>> [str(name) for name, _ in zip(part_names(Path("a/drive.mcap")), range(2))]
    ['a/drive.partial.mcap', 'a/drive.partial-2.mcap']
    """
    for number in chain(("",), (f"-{at}" for at in count(2))):
        yield beside(path, f".partial{number}", folder=folder)


def beside(path: Path, more: str, *, folder: bool = False) -> Path:
    """A name like an output's own, with `more` before its ending; as much of it is left out as makes room for that.

    >>> beside(Path("a/drive.mcap"), ".rest").name, len(beside(Path("x" * 250 + ".mcap"), ".rest").name)
    ('drive.rest.mcap', 239)
    """
    stem, suffix = (path.name, "") if folder else (path.stem, path.suffix)
    try:
        most = os.pathconf(path.parent, "PC_NAME_MAX")
    except (OSError, ValueError):
        most = _MOST_BYTES
    room = most - _COMPANION_BYTES - len(os.fsencode(more + suffix))
    while len(os.fsencode(stem)) > max(room, 1):
        stem = stem[:-1]
    return path.with_name(f"{stem}{more}{suffix}")


def _straight(path: Path) -> bool:
    try:
        kind = stat.S_IFMT(os.lstat(path).st_mode)
    except OSError:
        return False
    return kind in (stat.S_IFIFO, stat.S_IFCHR)


def _identity(path: Path) -> tuple[int, int]:
    """Device and inode, which stay the same as long as it is the same file or folder."""
    found = os.lstat(path)
    return found.st_dev, found.st_ino


def _umask() -> int:
    """Of this process. It can only be read by setting it, to one that gives less away."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
