"""If these fail, a full disk or a lack of memory leaves half an output behind, ends a process, or goes unsaid.

A few n here, and every n of the disk in `make sweeps`; `make faults` tries every n of all
(`python -m tests.failing`).
"""

from __future__ import annotations

import pytest

from tests.failing import shim
from tests.failing.rows import NETWORKS, STREAMS, rows
from tests.failing.running import swept
from tests.sweeps import ALL, sampled

pytestmark = pytest.mark.skipif(shim.compiler() is None, reason="no C++ compiler")

OUTPUTS = [row.name for row in rows() if row.name not in (*STREAMS, NETWORKS, "encode, points beside")]

SAMPLE = ["convert over an old file"]


@pytest.mark.parametrize("name", sampled(OUTPUTS, SAMPLE))
def test_a_disk_that_fails_leaves_no_output_or_a_whole_one(name: str) -> None:
    """Once, and from the n-th call on."""
    for found in swept(name, shim.Kind.DISK, at_most=None if ALL else 6):
        assert not found["wrong"]
        assert found["tries"] == (found["calls"] if ALL else min(6, found["calls"])) > 5


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["encode", "convert to a recording"])
@pytest.mark.parametrize("kind", [shim.Kind.CORE, shim.Kind.LARGE])
def test_memory_that_is_short_is_reported_in_a_line(name: str, kind: shim.Kind) -> None:
    (found,) = swept(name, kind, at_most=12 if ALL else 6)
    assert not found["wrong"]
    assert found["codes"].get("1", 0) > 0


@pytest.mark.sweep
def test_a_coder_for_whose_networks_memory_is_short_is_refused() -> None:
    """It ended the process."""
    (found,) = swept(NETWORKS, shim.Kind.CORE, at_most=None if ALL else 8)
    assert not found["wrong"]
    assert found["calls"] > 20
    assert found["tries"] == (found["calls"] if ALL else 8)


@pytest.mark.parametrize(
    "name", sampled(["stream of riddle", "stream of predictive", "stream of jpeg-layered"], ["stream of riddle"])
)
@pytest.mark.sweep
def test_a_stream_goes_on_after_a_frame_for_which_memory_was_short(name: str) -> None:
    (found,) = swept(name, shim.Kind.CORE, at_most=20 if ALL else 8)
    assert not found["wrong"]
    assert found["codes"].get("1", 0) > 0
