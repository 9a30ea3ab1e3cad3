"""Every codec x shape x content x bound x intensity through encoder and decoder: tests/contracts/combinations.py.

    python -m tests.fuzz.round_trips --codec riddle --shape "2048 packets"

Prints a line for each codec and shape, and each case that did not come back as promised; ends with 1 if there is one.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter

from lidarcodec.errors import LidarCodecError, SettingsError
from tests.contracts.combinations import CODECS, SHAPES, Case, all_cases


def outcome(case: Case, frames: int) -> str:
    """`held`, `refused` before anything was sent, or what went wrong."""
    try:
        case.check(frames)
    except SettingsError as error:
        return "refused" if case.refused else f"refused although it should not be: {error}"
    except LidarCodecError as error:
        return f"{type(error).__name__}: {error}"
    except Exception as error:
        return f"{type(error).__name__}, which is not ours: {str(error).strip().splitlines()[:1]}"
    return "held although it should be refused" if case.refused else "held"


def main() -> int:
    """Command line; 1 if a case did not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--codec", action="append", choices=CODECS)
    parser.add_argument("--shape", action="append", choices=SHAPES)
    parser.add_argument("--frames", type=int, default=2, help="frames of a stream (default 2)")
    options = parser.parse_args()
    wrong, total, began = 0, Counter[str](), time.perf_counter()
    for codec in options.codec or CODECS:
        for shape in options.shape or SHAPES:
            counts: Counter[str] = Counter()
            start = time.perf_counter()
            for case in all_cases():
                if (case.codec, case.shape) != (codec, shape):
                    continue
                what = outcome(case, options.frames)
                kind = what if what in ("held", "refused") else "wrong"
                counts[kind] += 1
                if kind == "wrong":
                    print(f"{case}: {what}", flush=True)
            listed = ", ".join(f"{number} {kind}" for kind, number in counts.most_common())
            print(f"{codec:26} {shape:14} {listed}, {time.perf_counter() - start:.0f} s", flush=True)
            total += counts
            wrong += counts["wrong"]
    print(f"{total.total()} cases in {time.perf_counter() - began:.0f} s: {dict(total)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
