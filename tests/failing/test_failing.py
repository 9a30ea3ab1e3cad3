"""If these fail, a full disk or a lack of memory leaves half an output behind, ends a process, or goes unsaid.

A few n of memory here, and every n of the disk for some outputs; `make faults` tries every n of both
(`python -m tests.failing`).
"""

from __future__ import annotations

import pytest

from tests.failing import shim
from tests.failing.rows import NETWORKS, STREAMS, rows
from tests.failing.running import swept
from tests.sweeps import sampled

pytestmark = pytest.mark.skipif(shim.compiler() is None, reason="no C++ compiler")

OUTPUTS = [row.name for row in rows() if row.name not in (*STREAMS, NETWORKS, "encode, points beside")]

SAMPLE = ["encode", "convert over an old file", "live recorder"]


@pytest.mark.parametrize("name", sampled(OUTPUTS, SAMPLE))
def test_a_disk_that_fails_leaves_no_output_or_a_whole_one(name: str) -> None:
    """Once, and from the n-th call on."""
    for found in swept(name, shim.Kind.DISK):
        assert not found["wrong"]
        assert found["tries"] == found["calls"] > 5


@pytest.mark.parametrize("name", sampled(["encode", "convert to a recording"], ["encode"]))
@pytest.mark.parametrize("kind", [shim.Kind.CORE, shim.Kind.LARGE], ids=["core", "large"])
def test_memory_that_is_short_is_said_in_a_line(name: str, kind: shim.Kind) -> None:
    (found,) = swept(name, kind, at_most=12)
    assert not found["wrong"]
    assert found["codes"].get("1", 0) > 0


def test_a_coder_for_whose_networks_memory_is_short_is_refused() -> None:
    """It ended the process."""
    (found,) = swept(NETWORKS, shim.Kind.CORE)
    assert not found["wrong"]
    assert found["tries"] == found["calls"] > 20


@pytest.mark.parametrize(
    "name", sampled(["stream of riddle", "stream of predictive", "stream of jpeg-layered"], ["stream of riddle"])
)
def test_a_stream_goes_on_after_a_frame_for_which_memory_was_short(name: str) -> None:
    (found,) = swept(name, shim.Kind.CORE, at_most=20)
    assert not found["wrong"]
    assert found["codes"].get("1", 0) > 0
