"""What somebody loses if these fail: a file, to an output that replaced it, followed a link, or was half there."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import stat
import subprocess
from pathlib import Path

import pytest

from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files import renaming
from lidarcodec.files import whole as whole_files
from lidarcodec.files.whole import drop_all, part_names, whole, written_whole
from tests.command_line import COMMAND, environment

SCANS = re.compile(r"\d+\.bin")


def write(path: Path, text: str = "new", **options: bool) -> None:
    with whole(path, **options) as output:
        output.beside.write_text(text)


def write_folder(path: Path, *, force: bool = False) -> None:
    with whole(path, force=force, contents=SCANS) as output:
        (output.beside / "0.bin").write_text("new")


@pytest.fixture(params=["as here", "as on file systems that can neither"])
def renames(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "as here":
        return

    def cannot(old: Path, new: Path, flags: int) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(renaming, "_renameat2", cannot)


@pytest.mark.usefixtures("renames")
def test_a_name_is_taken_when_all_is_written_and_nothing_else_is_left(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with whole(path) as output:
        output.beside.write_text("new")
        (hidden,) = tmp_path.iterdir()
        assert hidden == output.beside
        assert hidden.name.startswith(".drive.")
        assert hidden.suffix == ".mcap"
        assert stat.S_IMODE(hidden.stat().st_mode) == 0o600
    assert [one.name for one in tmp_path.iterdir()] == ["drive.mcap"]
    write_folder(tmp_path / "scans")
    assert (tmp_path / "scans" / "0.bin").read_text() == "new"


@pytest.mark.usefixtures("renames")
def test_nothing_is_replaced_unless_it_is_forced(tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    path.write_text("mine")
    with pytest.raises(SettingsError, match="--force"):
        write(path)
    assert path.read_text() == "mine"
    write(path, force=True)
    assert path.read_text() == "new"
    write_folder(tmp_path / "scans")
    (tmp_path / "scans" / "7.bin").write_text("old")
    with pytest.raises(SettingsError, match="not empty"):
        write_folder(tmp_path / "scans")
    write_folder(tmp_path / "scans", force=True)
    assert [one.name for one in (tmp_path / "scans").iterdir()] == ["0.bin"]
    assert sorted(one.name for one in tmp_path.iterdir()) == ["drive.mcap", "scans"]


@pytest.mark.usefixtures("renames")
def test_a_folder_with_other_peoples_files_stays_whatever_is_forced(tmp_path: Path) -> None:
    for name in ("letter.txt", "1.bin"):
        folder = tmp_path / name.replace(".", "_")
        folder.mkdir()
        if name == "1.bin":
            (folder / name).mkdir()
        else:
            (folder / name).write_text("mine")
        with pytest.raises(SettingsError, match="even --force does not"):
            write_folder(folder, force=True)
        assert (folder / name).exists()
    with pytest.raises(SettingsError, match="is a folder"):
        write(tmp_path / "letter_txt", force=True)


@pytest.mark.usefixtures("renames")
def test_what_appears_meanwhile_stays(tmp_path: Path) -> None:
    def during(path: Path, what: str, **options: object) -> None:
        with whole(path, **options) as output:  # type: ignore[arg-type]
            if options:
                (output.beside / "0.bin").write_text("new")
            if what == "link":
                path.symlink_to(tmp_path / "secret")
            elif what == "folder":
                path.mkdir()
                (path / "mine").write_text("mine")
            else:
                path.write_text("mine")

    for what in ("file", "link", "folder"):
        for options in ({}, {"contents": SCANS}):
            path = tmp_path / f"{what}{len(options)}"
            with pytest.raises(SourceError):
                during(path, what, **options)
            assert not (tmp_path / "secret").exists()
            assert os.path.lexists(path)
    assert not [one for one in tmp_path.iterdir() if one.name.startswith(".")]


@pytest.mark.usefixtures("renames")
@pytest.mark.parametrize("leads", ["nowhere", "to a file", "to a folder"])
def test_a_planted_link_is_never_followed(tmp_path: Path, leads: str) -> None:
    secret, path, folder = tmp_path / "secret", tmp_path / "drive.mcap", tmp_path / "scans"
    if leads == "to a file":
        secret.write_text("mine")
    elif leads == "to a folder":
        secret.mkdir()
    before = secret.read_text() if secret.is_file() else None
    for link in (path, folder):
        link.symlink_to(secret)
        with pytest.raises(SettingsError, match="exists"):
            write(path) if link is path else write_folder(folder)
    write(path, force=True)
    write_folder(folder, force=True)
    assert not path.is_symlink()
    assert not folder.is_symlink()
    assert (secret.read_text() if secret.is_file() else None) == before
    assert not secret.is_dir() or not list(secret.iterdir())


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd", "/dev/fd/1", "/proc/self", "/proc/self/fd/1"])
@pytest.mark.parametrize("contents", [None, re.compile("a")])
def test_links_of_the_system_are_replaced_by_nothing(name: str, contents: re.Pattern[str] | None) -> None:
    """`convert drive.pcap /dev/stdout --force` of root made a folder of it, for all programs of the machine."""
    if not Path(name).is_symlink():
        pytest.skip("there is no such link here")
    with pytest.raises(SettingsError, match="not a regular file: choose another name"):
        whole_files.check_free(Path(name), force=True, contents=contents)


def test_the_mode_is_the_one_of_new_files_or_private(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write(tmp_path / "open")
        with written_whole(tmp_path / "secret", private=True) as beside:
            beside.write_text("key")
        write_folder(tmp_path / "folder")
    finally:
        os.umask(before)
    modes = {one.name: stat.S_IMODE(one.stat().st_mode) for one in tmp_path.iterdir()}
    assert modes == {"open": 0o640, "secret": 0o600, "folder": 0o750}


def test_a_part_has_another_name_and_takes_nobodys_place(tmp_path: Path) -> None:
    path = tmp_path / "drive.pcap"
    names = part_names(path)
    for _ in range(2):
        with whole(path) as output:
            output.beside.write_text("part")
            output.companion(lambda kept: kept.with_name(f"{kept.stem}_db.xml"), ".xml").write_text("table")
            output.only_part()
        assert output.kept == next(names)
        assert (tmp_path / f"{output.kept.stem}_db.xml").read_text() == "table"
    assert next(part_names(tmp_path / "a.b", folder=True)).name == "a.b.partial"
    assert len(list(tmp_path.iterdir())) == 4


@pytest.mark.parametrize("fails", ["rename_new", "exchange"])
def test_a_rename_that_fails_leaves_what_was_there_and_the_calibration_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    path, table = tmp_path / "drive.pcap", tmp_path / "drive_db.xml"
    if fails == "exchange":
        path.write_text("mine")
        table.write_text("mine")
    real, calls = getattr(whole_files, fails), []

    def second_fails(one: Path, other: Path) -> bool:
        calls.append(one)
        if len(calls) == 2:
            raise OSError(5, "Input/output error", str(one))
        return bool(real(one, other))

    monkeypatch.setattr(whole_files, fails, second_fails)

    def attempt() -> None:
        with whole(path, force=True) as output:
            output.companion(lambda kept: kept.with_name(f"{kept.stem}_db.xml"), ".xml").write_text("new")
            output.beside.write_text("new")

    with pytest.raises(SourceError, match=r"cannot write .*drive\.pcap: Input/output error"):
        attempt()
    left = {one.name: one.read_text() for one in tmp_path.iterdir()}
    assert left == ({} if fails == "rename_new" else {"drive.pcap": "mine", "drive_db.xml": "mine"})


def test_whatever_ends_it_nothing_is_left(tmp_path: Path) -> None:
    for error in (ValueError, KeyboardInterrupt, MemoryError):
        with pytest.raises(error), whole(tmp_path / "file"):
            raise error
    begun = whole_files.Whole(tmp_path / "file")
    assert len(list(tmp_path.iterdir())) == 1
    drop_all()
    begun.drop()
    assert not list(tmp_path.iterdir())
    with pytest.raises(SourceError, match="cannot write"):
        write(tmp_path / "nowhere" / "file")


def test_an_error_about_another_file_is_not_said_to_be_of_this_one(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="missing"), whole(tmp_path / "file"):
        (tmp_path / "missing").read_text()
    with pytest.raises(SourceError, match=r"cannot write .*: No space left"), whole(tmp_path / "file"):
        raise OSError(28, "No space left on device")


def test_a_pipe_is_written_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "pipe.pcap"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write(path, "packets")
        assert os.read(reader, 100) == b"packets"
    finally:
        os.close(reader)
    assert [one.name for one in tmp_path.iterdir()] == ["pipe.pcap"]
    with pytest.raises(SettingsError, match="is not a regular file"):
        write_folder(path)


@pytest.mark.parametrize("there", [False, True])
@pytest.mark.parametrize("what", ["open", "fsync", "close", "chmod", "_renameat2", "mkdir"])
def test_whichever_call_fails_all_is_new_or_all_is_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, there: bool
) -> None:
    """Every call of its kind in turns, as an input/output error and as a full disk."""
    home = {"_renameat2": renaming, "chmod": Path, "mkdir": Path}.get(what, os)
    real = getattr(home, what)
    for error, number in [(error, number) for error in (5, 28) for number in range(1, 12)]:
        folder = tmp_path / f"{error}-{number}"
        folder.mkdir()
        path, table, scans = folder / "drive.pcap", folder / "drive_db.xml", folder / "scans"
        if there:
            path.write_text("old")
            table.write_text("old")
            write_folder(scans)
            (scans / "0.bin").write_text("old")
        calls: list[object] = []

        def fails(
            *given: object, calls: list[object] = calls, number: int = number, error: int = error, **more: object
        ) -> object:
            calls.append(given)
            if len(calls) == number:
                raise OSError(error, os.strerror(error))
            return real(*given, **more)

        with monkeypatch.context() as patched:
            patched.setattr(home, what, fails)
            failed = []
            try:
                with whole(path, force=True) as output:
                    output.companion(lambda kept: kept.with_name(f"{kept.stem}_db.xml"), ".xml").write_text("new")
                    output.beside.write_text("new")
            except SourceError:
                failed.append("file")
            try:
                write_folder(scans, force=True)
            except SourceError:
                failed.append("folder")
        left = {str(one.relative_to(folder)): one.read_text() for one in folder.rglob("*") if one.is_file()}
        before = "old" if there else None
        assert {left.pop("drive.pcap", None), left.pop("drive_db.xml", None)} == {before if "file" in failed else "new"}
        assert left.pop("scans/0.bin", None) == (before if "folder" in failed else "new")
        assert not left
        assert not [one for one in folder.iterdir() if one.name.startswith(".")]


def test_a_name_that_is_too_long_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    """It was found when all was written, and all of it was lost."""
    with pytest.raises(SettingsError, match="is too long for the file system"), whole(tmp_path / ("x" * 256)):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.sweep
def test_a_folder_that_cannot_be_written_to_is_all_that_is_said(tmp_path: Path) -> None:
    """Nothing was made there, and a second line said that it was left over."""
    mount = f"mount -t tmpfs -o ro none {shlex.quote(str(tmp_path))}"
    if not shutil.which("unshare") or subprocess.run(["unshare", "-rm", "sh", "-c", mount], check=False).returncode:
        pytest.skip("needs a file system of its own (unshare -rm, mount)")
    command = shlex.join([*COMMAND, "encode", "sim:road?frames=1", str(tmp_path / "a.mcap")])
    words = ["unshare", "-rm", "sh", "-c", f"{mount} && {command}"]
    done = subprocess.run(words, capture_output=True, text=True, env=environment(), check=False)
    assert done.returncode == 1
    assert done.stderr == f"lidarcodec: cannot write {tmp_path / 'a.mcap'}: Read-only file system\n"


@pytest.mark.parametrize("folder", [False, True])
def test_what_another_program_puts_in_the_place_of_an_output_is_not_kept_as_ours(tmp_path: Path, folder: bool) -> None:
    path = tmp_path / "drive"

    def exchanged() -> None:
        with whole(path, contents=SCANS if folder else None) as output:
            output.beside.rename(tmp_path / "ours")
            if folder:
                output.beside.mkdir()
            else:
                output.beside.write_text("theirs")

    with pytest.raises(SourceError, match="was replaced by another program"):
        exchanged()
    assert not path.exists()
