"""Two commands that write into one folder would mix up what they write."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from lidarcodec.errors import SourceError
from lidarcodec.files.folder_lock import alone_in
from tests.command_line import run_here


def test_a_folder_has_one_user_at_a_time_and_stays_while_it_holds_something(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "here"
    with alone_in(folder), pytest.raises(SourceError, match="another command is changing"), alone_in(folder):
        pass
    assert not folder.exists()
    with alone_in(folder):
        (folder / "half").touch()
    assert folder.exists()
    with alone_in(folder):
        (folder / "half").unlink()
    assert not folder.exists()


def test_a_folder_that_somebody_else_put_there_is_not_used(tmp_path: Path) -> None:
    """In a folder that all may write into, who makes `town.lcmap.building` first chooses what we write over."""
    theirs, planted = tmp_path / "theirs", tmp_path / "town.lcmap.building"
    theirs.mkdir()
    planted.symlink_to(theirs)
    with pytest.raises(SourceError, match="is a link, or belongs to another user"), alone_in(planted):
        pass
    if os.geteuid() == 0:
        os.chown(theirs, 65_534, 65_534)
        with pytest.raises(SourceError, match="is a link, or belongs to another user"), alone_in(theirs):
            pass
    assert sorted(tmp_path.iterdir()) == [theirs, planted]


@pytest.mark.parametrize(
    "words",
    [
        ("fetch", "car-7/roof", "--from", "-30", "--to", "now", "--patience", "1", "--out", "clip.mcap"),
        ("map", "fetch", "town", "--patience", "1", "--out", "clip.lcmap"),
    ],
)
def test_two_fetches_into_one_output_do_not_disturb_each_other(words: tuple[str, ...], tmp_path: Path) -> None:
    """One ended with 1, and the clip of the other was right by luck."""
    *command, out = words
    with alone_in(tmp_path / f"{out}.fetching"):
        done = run_here(*command, str(tmp_path / out))
    assert (done.returncode, "another command is changing" in done.stderr) == (1, True), done.stderr
    assert list(tmp_path.iterdir()) == []
