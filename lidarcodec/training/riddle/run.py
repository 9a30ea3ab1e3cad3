"""A complete training run: samples, a network of each kind and size, and the weight file.

A folder next to the file has samples and checkpoints. The same command continues a stopped run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from lidarcodec.errors import SettingsError
from lidarcodec.files.whole import written_whole
from lidarcodec.network.networks import SIZES, Net, Weights
from lidarcodec.network.shelf import weights_of
from lidarcodec.network.weight_file import pack_weights, unpack_weights
from lidarcodec.training import runs
from lidarcodec.training.riddle.drives import simulated_drives
from lidarcodec.training.riddle.fitting import FitSettings, Measured, fit
from lidarcodec.training.riddle.nets import HIDDEN, KEEP, exported, mean_bits
from lidarcodec.training.riddle.samples import Gathering, SampleStore
from lidarcodec.training.riddle.tiles import share_left

KINDS: Final = ("alone", "expecting")
HELD_ROWS: Final = 400_000
"""Number of samples of held-out drives for measurements, for each kind."""
_SIMULATED_HELD: Final = 8
"""One of so many simulated drives is held out."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class RiddleRun:
    """Options of a run.

    sources: drives to train on; scans: single scans, only for networks of kind alone; simulated: number of additional
             simulated drives; held: held-out drives for measurements, plus one in eight simulated drives
    begin:   a weight file with initial weights for networks with the same layers; `package`: weights of the package
    beside:  whether to also code sources as streams with the initial networks, for samples with context predictions
    tiles:   share of the weight tiles that large and largest networks keep; None: as in the package
    sizes, kinds: networks to train; fit: steps, batch, rate, precision of each; gathering: options of samples
    about:   notes in the file: licence, date, any JSON value
    """

    sources: tuple[str, ...] = ()
    scans: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    simulated: int = 0
    sizes: tuple[str, ...] = ("small", "large")
    kinds: tuple[str, ...] = KINDS
    steps: int = 8000
    batch: int = 8192
    rate: float = 3e-3
    precision: str = "float32"
    begin: str | None = None
    beside: bool = False
    tiles: float | None = None
    gathering: Gathering = field(default_factory=Gathering)
    about: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, given, known in (("size", self.sizes, tuple(HIDDEN)), ("kind", self.kinds, KINDS)):
            if not given or not set(given) <= set(known) or len(set(given)) != len(given):
                raise SettingsError(f"{name} = {','.join(given)}: choose from {', '.join(known)}", name)
        if not 0 <= self.simulated <= 100_000:
            raise SettingsError(f"--simulated must be 0 to 100000, not {self.simulated}", "simulated")
        if self.tiles is not None and not 0 < self.tiles <= 1:
            raise SettingsError(f"--tiles must be more than 0 and at most 1, not {self.tiles}", "tiles")
        if self.beside and self.begin is None:
            raise SettingsError("--beside needs networks to begin with: give --begin", "begin")
        if self.beside and not self.sources and not self.simulated:
            raise SettingsError("--beside needs drives, not single scans: give a source", "beside")
        if not self.sources and not self.scans and not self.simulated:
            raise SettingsError("nothing to train on: give sources, or --simulated N")
        if not self.held and self.simulated < _SIMULATED_HELD:
            raise SettingsError("nothing to measure on: give a held-out drive with --holdout", "holdout")
        for size in self.sizes:  # before samples are gathered, which takes hours
            self.fit_of(size, self.kinds[0])

    def fit_of(self, size: str, kind: str) -> FitSettings:
        """Training options of a network. Small networks keep all tiles."""
        expects = kind == "expecting"
        kept = KEEP[size][expects] if self.tiles is None or size == "small" else (self.tiles, self.tiles)
        return FitSettings(
            expects, HIDDEN[size], kept, self.steps, self.batch, self.rate, self.gathering.seed, self.precision
        )

    def drives(self) -> tuple[list[str], list[str]]:
        """Drives for training, and drives for measurements."""
        made = list(simulated_drives(self.simulated, self.gathering.seed))
        out = made[::_SIMULATED_HELD] if self.simulated >= _SIMULATED_HELD else []
        return [*self.sources, *(drive for drive in made if drive not in out)], [*self.held, *out]


def train(run: RiddleRun, out: Path, *, device: str = "auto", say: Say = print, every: int = 500) -> Weights:
    """Train the networks and write the weights to `out`. Samples and checkpoints are in the folder OUT.run.

    Raises SettingsError, SourceError, or errors of a source.
    """
    chosen, folder = runs.choose_device(device), out.with_name(f"{out.name}.run")
    training, held = run.drives()
    begun = None if run.begin is None else _begun_with(run.begin)
    if begun is not None and run.beside and len({net.expects for net in begun.nets}) < len(KINDS):
        raise SettingsError(f"{run.begin} has networks of only one kind, but coding drives needs both", "begin")
    beside, name = begun if run.beside else None, "" if begun is None else begun.name
    learned = SampleStore(folder, "training", run.gathering, training, run.scans, beside, name)
    measured = SampleStore(folder, "held-out", run.gathering, held, ())
    for store in (learned, measured):
        store.gather(say)
    before = () if begun is None else begun.nets
    nets, results = [], []
    for kind in run.kinds:
        expects = kind == "expecting"
        samples, looked_at = learned.rows(expects), measured.some(expects, HELD_ROWS)
        for size in run.sizes:
            settings = run.fit_of(size, kind)
            name = f"{kind}-{size}"
            begin = next((net for net in before if (net.expects, net.dims) == (expects, settings.dims)), None)
            net, state = fit(settings, samples, looked_at, folder / f"{name}.pt", device=chosen,
                             watch=_watcher(name, say), every=every, begin=begin)  # fmt: skip
            whole, bits = exported(net, SIZES.index(size), looked_at)
            nets.append(whole)
            results.append(
                _result(name, whole, settings, state, sum(map(len, samples)), mean_bits(net, looked_at), bits)
            )
    return _write(out, nets, _provenance(run, results))


def _watcher(name: str, say: Say) -> Callable[[Measured], None]:
    def watch(at: Measured) -> None:
        say(
            f"{name}: step {at.step}, {at.trained_bits:.4f} bits a return, "
            f"{at.held_bits:.4f} on held-out drives, {at.seconds:.0f} s"
        )

    return watch


def _result(
    name: str, net: Net, settings: FitSettings, state: runs.Checkpoint, rows: int, held: float, whole: float
) -> dict[str, Any]:
    return {
        "network": name,
        "hidden": list(net.dims[1:-1]),
        "tiles left": share_left(net),
        "steps": state.step,
        "batch": settings.batch,
        "samples": rows,
        "seconds": round(state.seconds),
        "held out, bits": round(held, 4),
        "in whole numbers": round(whole, 4),
    }


def _provenance(run: RiddleRun, results: list[dict[str, Any]]) -> dict[str, Any]:
    from lidarcodec import __version__

    return {
        "trained on": [_name(spec) for spec in run.sources],
        "single scans": [_name(spec) for spec in run.scans],
        "simulated drives": run.simulated,
        "held out": [_name(spec) for spec in run.held],
        "seed": run.gathering.seed,
        "rate": run.rate,
        **({} if run.begin is None else {"begun with": _provenance_of(run.begin)}),
        **({"beside contexts": True} if run.beside else {}),
        "precision": run.precision,
        "networks": results,
        "tool": f"lidarcodec {__version__}",
        **run.about,
    }


def _begun_with(begin: str) -> Weights:
    return weights_of("" if begin == "package" else begin)


def _provenance_of(begin: str) -> dict[str, Any]:
    """Provenance of the initial weights, which is also provenance of the new weights."""
    before = _begun_with(begin)
    return {"weights": before.name, **before.provenance}


def _name(spec: str) -> str:
    """A source without its folder, because folder names may be private."""
    return spec if spec.startswith("sim:") else Path(spec).name


def _write(out: Path, nets: list[Net], provenance: dict[str, Any]) -> Weights:
    data = pack_weights(nets, provenance)
    with written_whole(out) as path:
        path.write_bytes(data)
    return unpack_weights(data)
