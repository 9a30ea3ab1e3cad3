"""Shared by all training runs: device, resumable random numbers, learning rate, checkpoints.

The random generators of a step are made from the run's seed and the number of the step. So a run that was resumed from
a checkpoint gives exactly the weights of an uninterrupted run, and a checkpoint needs no state of generators.

>>> int(step_rng(7, 100).integers(1000)) == int(step_rng(7, 100).integers(1000))
True
>>> [round(rate_at(step, 100, peak=1.0, warm_up=10), 3) for step in (0, 9, 99)]
[0.1, 1.0, 0.003]
"""

from __future__ import annotations

import io
import math
import pickletools
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from zipfile import ZipFile

import numpy as np
import torch

from lidarcodec.budgets import largest
from lidarcodec.errors import SettingsError, SourceError
from lidarcodec.files.regular import open_regular
from lidarcodec.files.whole import written_whole
from lidarcodec.untrusted.npz import ArraysRefusedError, check_archive

Value = str | int | float | bool | None | list[Any]
"""Types of a run's settings, which are stored in its checkpoints."""

_KIND: Final = "lidarcodec training run"
_VERSION: Final = 1
_NAMES: Final = ("collections OrderedDict", "torch._utils _rebuild_tensor_v2")
_STORAGE: Final = re.compile(r"torch [A-Z][A-Za-z0-9]{0,15}Storage")
_LOOKUPS: Final = ("GLOBAL", "STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4")
"""Names that the pickle in a checkpoint may use, and the opcodes that use a name."""


def choose_device(name: str = "auto") -> torch.device:
    """The device for training: `auto` is a GPU if there is one, otherwise the CPU.

    Raises SettingsError for a name that torch does not know, or a GPU that does not exist.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0]
        raise SettingsError(f"device {name!r} cannot be used: {reason}", "device") from None
    return device


def limit_threads(count: int) -> None:
    """Use at most `count` CPU threads from here on. Raises SettingsError if it is less than 1."""
    if count < 1:
        raise SettingsError(f"{count} threads: at least 1 is needed", "threads")
    torch.set_num_threads(count)


def seed_torch(seed: int, step: int = 0) -> None:
    """Seed torch's own generators (initial weights, dropout) for a step. Call it before the network is made, and in
    every step that uses random numbers of torch."""
    torch.manual_seed(int(np.random.SeedSequence([seed, step]).generate_state(1, np.uint64)[0] >> 1))


def step_rng(seed: int, step: int, *stream: int) -> np.random.Generator:
    """The random generator of a step. stream: numbers of independent generators of the same step"""
    return np.random.default_rng([seed, step, *stream])


def rate_at(step: int, steps: int, *, peak: float, warm_up: int = 100, floor: float = 0.003) -> float:
    """Learning rate of a step: linear up to `peak` over `warm_up` steps, then a cosine down to `floor` times `peak` at
    the last of `steps`. It depends only on the step, so it needs no state in checkpoints."""
    warm_up = min(warm_up, steps)
    if step < warm_up:
        return peak * (step + 1) / warm_up
    done = (step - warm_up + 1) / max(steps - warm_up, 1)
    return peak * (floor + (1 - floor) * 0.5 * (1 + math.cos(math.pi * min(done, 1.0))))


def set_rate(optimiser: torch.optim.Optimizer, rate: float) -> None:
    """Set the learning rate of all groups of an optimiser."""
    for group in optimiser.param_groups:
        group["lr"] = rate


@dataclass
class Checkpoint:
    """The state of a training run, complete enough to continue it exactly.

    step:      number of steps done
    settings:  options of the run; it can be continued only with the same options
    model:     state of the network; optimiser: state of the optimiser
    seconds:   training time so far
    log:       a mapping for each measurement so far
    """

    step: int
    settings: dict[str, Value]
    model: dict[str, Any]
    optimiser: dict[str, Any]
    seconds: float = 0.0
    log: list[dict[str, Value]] = field(default_factory=list)

    def require(self, settings: Mapping[str, Value], may_differ: frozenset[str] = frozenset()) -> None:
        """Check that the run has these settings; those in `may_differ` may be different.

        Raises SettingsError with the name of the first different one.
        """
        for name in sorted(self.settings.keys() | settings.keys()):
            then, now = self.settings.get(name), settings.get(name)
            if then != now and name not in may_differ:
                raise SettingsError(
                    f"the run to resume has {name} = {then!r}, not {now!r}: use that value, or another folder", name
                )


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint completely or not at all: to a temporary file, which is then renamed.

    Raises SourceError if it cannot be written.
    """
    values = {"kind": _KIND, "version": _VERSION, **vars(checkpoint)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SourceError(f"cannot write {path}: {error.strerror or error}") from None
    content = io.BytesIO()
    torch.save(values, content)  # not directly to the file: on a full disk torch's error does not say so
    with written_whole(path) as beside:
        beside.write_bytes(content.getbuffer())


def _check_names(archive: ZipFile) -> None:
    """Raises ArraysRefusedError if a checkpoint uses names other than those of tensors. torch would also allow a
    `bytearray` of any length, made from a number."""
    for member in archive.namelist():
        if not member.endswith("data.pkl"):
            continue
        for opcode, argument, _ in pickletools.genops(archive.read(member)):
            known = argument in _NAMES or (isinstance(argument, str) and _STORAGE.fullmatch(argument))
            if opcode.name in _LOOKUPS and not (opcode.name == "GLOBAL" and known):
                raise ArraysRefusedError("it uses a name that checkpoints do not have")


def _check_tensors(values: object) -> None:
    """Raises ArraysRefusedError for a tensor that claims to have more numbers than are stored."""
    left = [values]
    while left:
        one = left.pop()
        if isinstance(one, torch.Tensor):
            if one.numel() * one.element_size() > one.untyped_storage().nbytes():
                raise ArraysRefusedError("it has a tensor that is larger than its stored data")
        elif isinstance(one, Mapping):
            left.extend(one.values())
        elif isinstance(one, list | tuple):
            left.extend(one)


def load_checkpoint(path: Path, device: torch.device | None = None) -> Checkpoint | None:
    """The checkpoint at `path`, with tensors on `device` (default: the CPU); None if there is none.

    Only numbers, text and tensors are read, so a file from an untrusted source cannot run code.
    Raises SourceError if the file is not a checkpoint, or has another version.
    """
    if not path.exists():
        return None
    damaged = f"{path} is not a checkpoint, or damaged: remove it to start again"
    try:
        with open_regular(path) as file, check_archive(file, largest("checkpoint") or 0, stored=True) as archive:
            _check_names(archive)  # not an archive: an older format of torch, which lidarcodec never writes
        values = torch.load(path, map_location=device or "cpu", weights_only=True)
        _check_tensors(values)
    except OSError as error:
        raise SourceError(f"cannot read the checkpoint {path}: {error.strerror or error}") from None
    except Exception:  # a damaged archive may raise any error
        raise SourceError(damaged) from None
    if not isinstance(values, dict) or values.pop("kind", None) != _KIND:
        raise SourceError(f"{path} is not a checkpoint of a training run")
    version = values.pop("version", None)
    if version != _VERSION:
        raise SourceError(f"{path} is a checkpoint of version {version}; this program reads {_VERSION}")
    try:
        return Checkpoint(**values)
    except TypeError:
        raise SourceError(f"{path} is a damaged checkpoint: remove it to start again") from None
