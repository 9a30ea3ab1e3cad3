"""`python tools/plane_cells.py` learns what cells of planes begin with, from frames of the simulator alone. It writes
native/src/images/first_cells.hpp, and the same table into docs/wire-format-planes.md.

native/check/first_cells.cpp does the learning; it is built with g++. The numbers are the same on every machine.
"""

from __future__ import annotations

import re
import struct
import subprocess
import tempfile
from pathlib import Path
from typing import Final

import numpy as np

from lidarcodec.codecs.plane_content import shift_of
from lidarcodec.entropy.plane_coder import form_table, in_order
from lidarcodec.frame_images import images_of, layout_of
from lidarcodec.pipeline import frames_of
from lidarcodec.sources import open_source

ROOT: Final = Path(__file__).resolve().parent.parent
HEADER: Final = ROOT / "native/src/images/first_cells.hpp"
PAGE: Final = ROOT / "docs/wire-format-planes.md"
HEAD: Final = """// Written by tools/plane_cells.py, which says what these are. Not to be edited.
// clang-format off
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>

namespace lidarcodec {

// Of the nodes 1 to 15 of each context, in steps of 256.
inline constexpr std::size_t kBesideContexts = 169;
inline constexpr std::array<std::int8_t, kBesideContexts * 15> kFirstBeside = {
"""
DUAL: Final = "&profile=RNG19_RFL8_SIG16_NIR16_DUAL"
NARROW: Final = "&profile=RNG15_RFL8_NIR8"
TWO: Final = "&returns=dual"
DRIVES: Final = (
    ("city", "vls128"),
    ("garage", f"os1-128{NARROW}"),
    ("street", "vlp32c"),
    ("road", "os2-128"),
    ("city", f"vlp16{TWO}"),
    ("street", f"os0-32{DUAL}"),
    ("road", "vls128"),
    ("city", "os1-64"),
    ("garage", f"pandar40p{TWO}"),
    ("city", "os2-128"),
    ("motorway", "vls128"),
    ("garage", "vlp32c"),
    ("street", f"os1-128{NARROW}"),
    ("city", f"pandar64{TWO}"),
    ("road", "os1-128"),
    ("garage", "os1-32"),
    ("street", "vls128"),
    ("city", f"os0-32{DUAL}"),
    ("garage", "xt16"),
    ("city", "hdl32e"),
    ("motorway", "os2-128"),
    ("city", "vlp32c"),
    ("garage", f"vlp16{TWO}"),
    ("road", "os0-32"),
    ("street", f"xt32{TWO}"),
    ("city", f"os1-128{NARROW}"),
    ("garage", "vls128"),
    ("city", "os0-128&mode=512x10"),
    ("street", "os2-128"),
    ("road", "vlp32c"),
    ("garage", f"os0-32{DUAL}"),
    ("city", f"qt64{TWO}"),
    ("street", "vlp16"),
    ("city", "os1-128"),
)
"""Scene and sensor of each frame; its number is the seed."""


def frame_bytes(number: int, scene: str, sensor: str) -> bytes:
    """A frame as native/check/first_cells.cpp reads it."""
    with open_source(f"sim:{scene}?sensor={sensor}&seed={number + 1}&frames=3&skip=20") as source:
        frame = list(frames_of(source.packets(), source.sensor, "revolution"))[1]
    found = layout_of(frame)
    assert found is not None
    layout = found[1]
    ordered = in_order(layout.planes)
    planes = images_of(frame, layout).planes
    parts = [struct.pack("<3I", *planes["range"].shape, len(ordered)), form_table(ordered).tobytes()]
    parts += [shift_of(frame).astype("<i4").tobytes(), *(planes[one.name].astype("<u4").tobytes() for one in ordered)]
    return b"".join(parts)


def learned() -> list[list[int]]:
    """The table: the nodes 1 to 15 of each context."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "first_cells"
        sources = [ROOT / "native/check/first_cells.cpp", ROOT / "native/src/images/heads.cpp"]
        flags = ["-std=c++20", "-O2", "-ffp-contract=off", f"-I{ROOT / 'native/src'}"]
        subprocess.run(["g++", *flags, "-o", str(program), *map(str, sources)], check=True)
        given = b"".join(frame_bytes(number, *drive) for number, drive in enumerate(DRIVES))
        out = subprocess.run([str(program), str(len(DRIVES))], input=given, capture_output=True, check=True).stdout
    return np.frombuffer(out, np.int8).reshape(-1, 16)[:, 1:].tolist()


def main() -> None:
    """Write both files."""
    rows = [", ".join(map(str, row)) for row in learned()]
    HEADER.write_text(HEAD + "".join(f"    {row},\n" for row in rows) + "};\n\n}  // namespace lidarcodec\n")
    table = "".join(row.replace(",", "") + "\n" for row in rows)
    page = PAGE.read_text()
    PAGE.write_text(re.sub(r"(## First cells\n.*?```\n).*?(```)", rf"\g<1>{table}\2", page, flags=re.DOTALL))


if __name__ == "__main__":
    main()
