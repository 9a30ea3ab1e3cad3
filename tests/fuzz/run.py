"""Feeds damaged packets, messages and captures to everything that reads bytes from outside.

    python -m tests.fuzz.run --cases 100000 --seed 1

Prints, by target, how many cases gave which error of the project, and how many were decoded after all. Anything else
than an error of lidarcodec.errors, or a decode that takes over a second of the processor, or 512 MiB more than before,
ends the run with the case on disk. All begin with the valid extremes of `tests.fuzz.corpus`; a quarter of the cases are
messages whose checksums are right again, one after another with valid ones between them (`tests.fuzz.campaign`).
"""

from __future__ import annotations

import argparse
import logging
import random
import resource
import time
import warnings
from collections import Counter
from collections.abc import Callable, Collection
from pathlib import Path

from lidarcodec.assembly import Assembler, packets_of
from lidarcodec.codecs import table
from lidarcodec.errors import LidarCodecError
from lidarcodec.packet import Packet
from lidarcodec.pipeline import StreamDecoder, StreamEncoder, frames_of
from lidarcodec.settings import settings_from
from lidarcodec.wire import pack, unpack
from tests.fuzz.campaign import LARGEST_MIB, SLOWEST_S, block
from tests.fuzz.chains import CASES, decode_all
from tests.fuzz.corpus import OTHER_SHARES, SHARES, plans, stream
from tests.fuzz.mutations import mutated
from tests.packets import sensor, turning

QUICK = ("extremes", "tiny")
"""Sizes of messages that take about a millisecond."""

Target = Callable[[random.Random], tuple[bytes, Callable[[bytes], object]]]


def message_target(codec: str) -> Target:
    """Damaged messages of one codec, as a bad link damages them: their checksums are wrong."""
    clean = [
        data for plan in plans() if plan.name == codec and plan.size in QUICK for data in stream(plan, seed=1).messages
    ]

    def case(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
        return mutated(rng.choice(clean), rng), lambda data: decode_all(StreamDecoder(), data)

    return case


EXACT = [name for name in table.names() if table.codec(name).bounded]
"""Codecs that are lossless unless told otherwise."""


def packet_target(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
    """Damaged payloads, through a lossless codec and back: they must come back exactly."""
    payloads = [
        mutated(p.payload, rng)[:1206].ljust(1206, b"\0") for p in turning(rng.choice((1, 3)), rng.randrange(99))
    ]

    def round_trip(data: bytes) -> None:
        packets = [Packet(data[at : at + 1206], at) for at in range(0, len(data), 1206)]
        encoder, decoder = StreamEncoder(settings_from({"codec": rng.choice(EXACT)}), 1), StreamDecoder()
        back: list[bytes] = []
        for frame in frames_of(packets, sensor(), rng.choice(("packets:2", "revolution"))):
            for message in encoder.encode(frame):
                for decoded in decoder.decode(unpack(pack(message))):
                    back += [p.payload for p in packets_of(decoded)]
        if back != [p.payload for p in packets]:
            raise AssertionError("packets did not come back")

    return b"".join(payloads), round_trip


def length_target(rng: random.Random) -> tuple[bytes, Callable[[bytes], object]]:
    """Payloads of any length."""
    return rng.randbytes(rng.choice((0, 1, 512, 1205, 1207, 3000))), lambda d: Assembler(sensor()).push(
        Packet(d, 0, position=rng.random() < 0.5)
    )


def targets() -> dict[str, Target]:
    """Everything that is fuzzed, by name."""
    from tests.fuzz.files import capture_target, recording_target, rosbag_target  # they need the readers; kept apart
    from tests.fuzz.images import image_targets
    from tests.fuzz.layers import refinement_target
    from tests.fuzz.sensors import sensor_targets
    from tests.fuzz.weights import weights_target

    found: dict[str, Target] = {"packets": packet_target, "packet lengths": length_target}
    for codec in table.names():
        found[f"{codec} messages"] = message_target(codec)
    files = {"captures": capture_target(), "recordings": recording_target(), "bags": rosbag_target()}
    more = {"riddle weights": weights_target(), "refinements": refinement_target()}
    return found | image_targets() | files | more | sensor_targets()


def peak_mib() -> int:
    """The most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def run(cases: int, seed: int, crash_dir: Path, todo: dict[str, Target]) -> dict[str, Counter[str]]:
    """Outcome counts by target of `cases` cases in all.

    Raises whatever is not an error of the project, with the bytes kept in `crash_dir`.
    """
    outcomes: dict[str, Counter[str]] = {}
    before = peak_mib()
    for name, make in todo.items():
        counts = outcomes[name] = Counter()
        for number in range(-(-cases // len(todo))):
            rng = random.Random(f"{seed}/{name}/{number}")
            data, feed = make(rng)
            began = time.process_time()
            try:
                feed(data)
                counts["decoded"] += 1
            except LidarCodecError as error:
                counts[type(error).__name__] += 1
            except BaseException:
                crash_dir.mkdir(parents=True, exist_ok=True)
                (crash_dir / f"crash-{name.replace(' ', '_')}-{number}").write_bytes(data)
                print(f"{name}, case {number}: the bytes are in {crash_dir}")
                raise
            took, more = time.process_time() - began, peak_mib() - before
            if took > SLOWEST_S or more > LARGEST_MIB:
                raise AssertionError(f"{name}, case {number}: {took:.1f} s, {more} MiB more than before")
    return outcomes


def run_sealed(
    cases: int, seed: int, kept: Path, sizes: Collection[str] = (*SHARES, *OTHER_SHARES)
) -> dict[str, Counter[str]]:
    """The same of damaged messages with right checksums, in all configurations of these sizes, each its share.

    Raises AssertionError for what broke a rule, with every message that led to it kept in a folder.
    """
    chosen, outcomes = [plan for plan in plans() if plan.size in sizes], {}
    shares = sum(plan.share for plan in chosen)
    for plan in chosen:
        limit = max(1, round(cases * plan.share / shares / CASES))
        counts = block(stream(plan, seed), seed, 0, at=None, kept=kept, limit=limit)
        if counts.found:
            raise AssertionError("; ".join(counts.found))
        outcomes[f"{plan.name}, {plan.size}, sealed"] = Counter(counts.outcomes)
    return outcomes


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="targets whose name holds this, and no sealed messages")
    parser.add_argument("--crashes", type=Path, default=Path("crash-found"))
    options = parser.parse_args()
    logging.getLogger("lidarcodec").setLevel(logging.ERROR)  # what is wrong with each case is told in the counts
    warnings.simplefilter("error", RuntimeWarning)  # numpy's, which a viewer would see
    began = time.perf_counter()
    todo = {name: make for name, make in targets().items() if options.only in name}
    outcomes = run(options.cases if options.only else options.cases * 3 // 4, options.seed, options.crashes, todo)
    if not options.only:
        outcomes |= run_sealed(options.cases // 4, options.seed, options.crashes)
    for name, counts in outcomes.items():
        listed = ", ".join(f"{what} {n}" for what, n in counts.most_common())
        print(f"{name:45} {counts.total():7} cases: {listed}")
    total = sum(counts.total() for counts in outcomes.values())
    print(f"{total} cases in {time.perf_counter() - began:.0f} s, seed {options.seed}: no other exception, no crash")


if __name__ == "__main__":
    main()
