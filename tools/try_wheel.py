"""Tries an installed wheel as a user would: describes, codes, decodes and compares a simulated drive. Takes seconds.

    python -P tools/try_wheel.py

It needs nothing but the package, which may not be the one of the folder beside this file.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import lidarcodec

ROOT = Path(__file__).resolve().parent.parent
CODECS = ("pcodec", "predictive", "riddle")


def main() -> None:
    """Raises CalledProcessError if a command fails, SystemExit if another package would be tried or packets differ."""
    if Path(lidarcodec.__file__).is_relative_to(ROOT / "lidarcodec"):
        sys.exit("this is the package of the checkout: install the wheel into an environment of its own")
    with tempfile.TemporaryDirectory() as folder:
        drive = Path(folder, "drive.pcap")
        _run("simulate", "sim:city", drive, "--frames", 3)
        _run("info", drive)
        for codec in CODECS:
            recording, back = Path(folder, f"{codec}.mcap"), Path(folder, f"{codec}.pcap")
            _run("encode", drive, recording, "--codec", codec)
            _run("verify", recording, drive)
            _run("decode", recording, back)
            if len(back.read_bytes()) != len(drive.read_bytes()):
                sys.exit(f"{codec}: decoded packets have another size")
        _run("doctor")
    print(f"lidarcodec {lidarcodec.__version__} works on Python {sys.version.split()[0]}: {lidarcodec.__file__}")


def _run(*words: object) -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-m", "lidarcodec", *map(str, words)], capture_output=True, text=True, check=False
    )
    print(f"{words[0]}: {(done.stdout or done.stderr).splitlines()[-1:]}")
    if done.returncode:
        sys.exit(done.stderr)


if __name__ == "__main__":
    main()
