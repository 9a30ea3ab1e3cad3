"""The committed decoder of the page is what the native sources give; nobody else would notice that it is older."""

from __future__ import annotations

from hashlib import sha256

from tests.conftest import ROOT

WORKER = ROOT / "clients" / "web" / "src" / "decode" / "worker"
REBUILD = (
    "the decoder of the page is older than its sources: `make wasm`, then `make web`, and commit what they wrote."
    " It needs, on Debian 12: apt-get install clang lld wasi-libc libc++-14-dev-wasm32 libc++abi-14-dev-wasm32"
    " libclang-rt-14-dev-wasm32"
)


def test_the_committed_module_was_built_from_these_sources():
    lines = (WORKER / "decoder.sources").read_text().splitlines()
    told = {name: digest for digest, name in (line.split() for line in lines)}
    there = {name: sha256((ROOT / name).read_bytes()).hexdigest() for name in told if (ROOT / name).is_file()}
    assert told == there, REBUILD
    assert {path.relative_to(ROOT).as_posix() for path in (ROOT / "native" / "wasm").rglob("*.?pp")} <= told.keys()


def test_the_module_is_small_and_asks_nothing_of_a_system():
    """A page fetches it; and what it may do is decode, and have the page decompress, nothing else."""
    data = (WORKER / "decoder.wasm").read_bytes()
    assert data[:4] == b"\0asm"
    assert len(data) < 760_000
    assert b"wasi_snapshot" not in data
