"""The table of formats for frames, the choice by name and ending, and the opening of an output.

>>> form_of(Path("drive.laz")).name, form_of(Path("scans"), folder="kitti").name, form_of(Path("x.pcd")).extra
('laz', 'kitti', '')
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final, cast

from lidarcodec.cloud import Returns
from lidarcodec.commands.outputs.base import USUAL, BagNames, Output
from lidarcodec.commands.outputs.folder import FolderOutput
from lidarcodec.errors import MissingExtraError, SettingsError, UnknownNameError
from lidarcodec.files.whole import check_free

FOLDER_FILES: Final = re.compile(r"\d{6,}\.(bin|npz|ply|pcd|las|laz|csv|e57)|timestamps\.json")
"""Names of the files in a folder with a file for each frame."""
BAG_FILES: Final = re.compile(r".*_\d+\.mcap|metadata\.yaml|db\.xml")
"""Names of the files in a rosbag2, and of a calibration that `convert` may put there."""


@dataclass(frozen=True)
class Form:
    """A format for frames.

    ending: of its files;  made_by: module and class in this folder
    points: whether it holds points, which can be moved, cut and merged
    each: whether a folder can have a file for each frame
    numbered: whether a point can say which return of its beam it is
    package, extra: what must be installed; empty if nothing
    """

    name: str
    ending: str
    made_by: str
    points: bool = True
    each: bool = True
    numbered: bool = True
    package: str = ""
    extra: str = ""

    @property
    def first_returns(self) -> bool:
        """Whether it holds the first return of each beam alone, unless all are asked for."""
        return self.points or self.is_bag

    @property
    def is_bag(self) -> bool:
        """Whether a folder of it is a rosbag2."""
        return self.name == "clouds"

    @property
    def only_each(self) -> bool:
        """Whether there is a file for each frame in any case."""
        return self.name == "kitti"

    def open(self, path: Path) -> Output:
        """An open file of this format. Raises OSError if it cannot be written."""
        module, _, name = self.made_by.partition(":")
        made = getattr(importlib.import_module(f"lidarcodec.commands.outputs.{module}"), name)
        return cast(Callable[[Path], Output], made)(path)


FORMS: Final = {
    form.name: form
    for form in (
        Form("pcap", ".pcap", "pcap:PcapOutput", points=False, each=False),
        Form("clouds", ".mcap", "bag:BagOutput", points=False, each=False),
        Form("npz", ".npz", "npz:NpzOutput", points=False),
        Form("ply", ".ply", "ply:PlyOutput"),
        Form("pcd", ".pcd", "pcd:PcdOutput"),
        Form("pcd-compressed", ".pcd", "pcd:CompressedPcdOutput", package="imagecodecs", extra="images"),
        Form("las", ".las", "las:LasOutput", package="laspy", extra="las"),
        Form("laz", ".laz", "las:LazOutput", package="lazrs", extra="las"),
        Form("csv", ".csv", "text:CsvOutput"),
        Form("e57", ".e57", "e57:E57Output", numbered=False, package="pye57", extra="e57"),
        Form("kitti", ".bin", "kitti:KittiScan", numbered=False),
    )
}
NUMBERED: Final = re.compile(r"%0?\d*d")
"""How other programs name a file for each frame."""
ENDINGS: Final = tuple(dict.fromkeys(form.ending for form in FORMS.values() if not form.only_each))

SCANS: Final = "a folder for KITTI .bin, a file for each frame"
"""What a folder is where no other format can be named."""


def suffix(path: Path) -> str:
    """The ending of an output's name; empty for a folder."""
    return "" if path.is_dir() else path.suffix.lower()


def form_of(
    path: Path,
    name: str | None = None,
    *,
    folder: str | None = None,
    further: Sequence[str] = (),
    each: str = "a folder and --as {form} for one file a frame",
) -> Form:
    """The format called `name`, otherwise that of the path's ending; folder: the format of a path without one.
    further: other names that the command knows, for its error;  each: how a file for each frame is had, for it, too

    Raises UnknownNameError, or SettingsError if there is none or the path does not fit.
    """
    ending = suffix(path)
    if NUMBERED.search(path.name):
        raise SettingsError(f"{path} is not a pattern for numbered files: give {each.format(form=name or ending[1:])}")
    if name is None:
        name = folder if not ending else next((one.name for one in FORMS.values() if one.ending == ending), None)
        if name is None or (ending and FORMS[name].only_each):
            known = f"{' '.join(ENDINGS[:-1])} or {ENDINGS[-1]}"
            raise SettingsError(
                f"cannot write {path}: give a name that ends in {known}, or {each.format(form='FORMAT')}"
            )
    if name not in FORMS:
        raise UnknownNameError("format", name, dict.fromkeys((*further, *FORMS)))
    form = FORMS[name]
    if ending and (ending != form.ending or form.only_each):
        raise SettingsError(
            f"--as {name} does not fit {path}: give a name that ends in {form.ending}, or a folder", "as"
        )
    if not ending and not form.each and not form.is_bag:
        raise SettingsError(f"--as {name} writes a single file: {path} must end in {form.ending}", "as")
    return form


def check_output(path: Path, form: Form, *, force: bool = False) -> None:
    """Raise SettingsError if writing would replace an existing output; MissingExtraError if the library for this format
    is not installed."""
    if form.package and find_spec(form.package) is None:
        raise MissingExtraError(f"writing {path}", form.extra)
    if form.name != "pcap" and (path.is_fifo() or path.is_char_device()):
        raise SettingsError(f"{path} is a pipe or a device: only packets (.pcap) can be written to it")
    check_free(path, force=force, contents=contents_of(path, form))


def check_returns(form: Form, returns: str) -> None:
    """Raise SettingsError if all returns are asked for and a point in this format cannot say which one it is."""
    if returns == "all" and form.first_returns and not form.numbered:
        raise SettingsError(
            f"all returns cannot be written as {form.name}: use .ply, .pcd, .las, .laz, .csv or --as clouds", "returns"
        )


def contents_of(path: Path, form: Form) -> re.Pattern[str] | None:
    """Names of the files in an output folder; None if the output is a file."""
    if suffix(path):
        return None
    return BAG_FILES if form.is_bag else FOLDER_FILES


def open_output(path: Path, form: Form, beside: Path, names: BagNames = USUAL, returns: Returns = "first") -> Output:
    """The output of this format, written to `beside`. names: in a bag;  returns: those in a bag; other formats get them
    as clouds

    Raises OSError if it cannot be written.
    """
    if form.is_bag:
        from lidarcodec.commands.outputs.bag import BagOutput

        return BagOutput(beside, names, folder="" if suffix(path) else path.name, returns=returns)
    return form.open(beside) if suffix(path) else FolderOutput(beside, form.ending, form.open)


@contextmanager
def opened(
    path: Path, form: Form, beside: Path, names: BagNames = USUAL, returns: Returns = "first"
) -> Iterator[Output]:
    """The open output of `open_output`. It is completed at the end; after an error its files are only closed."""
    writer = open_output(path, form, beside, names, returns)
    try:
        yield writer
    except BaseException:
        with suppress(Exception):
            writer.close()
        raise
    writer.close()
