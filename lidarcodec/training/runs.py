"""What every training run needs: a device, randomness that can be resumed, a rate, checkpoints.

A step draws from generators made from the run's seed and the step's number, never from one that runs on: so a run that
was stopped and resumed from a checkpoint makes the very weights of one that was not, and a checkpoint need not hold
the state of any generator.

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
"""What a setting of a run may be: it is written into its checkpoints."""

_KIND: Final = "lidarcodec training run"
_VERSION: Final = 1
_NAMES: Final = ("collections OrderedDict", "torch._utils _rebuild_tensor_v2")
_STORAGE: Final = re.compile(r"torch [A-Z][A-Za-z0-9]{0,15}Storage")
_LOOKUPS: Final = ("GLOBAL", "STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4")
"""What a checkpoint may name, and the opcodes of a pickle that name something."""


def choose_device(name: str = "auto") -> torch.device:
    """The device to train on: `auto` takes a GPU when there is one, else the CPU.

    Raises SettingsError for a name that torch does not know, or a GPU that is not there.
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
    """Uses at most `count` threads of the CPU from here on. Raises SettingsError if that is not at least 1."""
    if count < 1:
        raise SettingsError(f"{count} threads: at least 1 is needed", "threads")
    torch.set_num_threads(count)


def seed_torch(seed: int, step: int = 0) -> None:
    """Seeds torch's own generators (first weights, dropout) for a step: call it before the network is made, and in
    every step of one that draws random numbers."""
    torch.manual_seed(int(np.random.SeedSequence([seed, step]).generate_state(1, np.uint64)[0] >> 1))


def step_rng(seed: int, step: int, *stream: int) -> np.random.Generator:
    """Generator of what step `step` draws; further numbers name independent generators of the same step."""
    return np.random.default_rng([seed, step, *stream])


def rate_at(step: int, steps: int, *, peak: float, warm_up: int = 100, floor: float = 0.003) -> float:
    """Learning rate of a step: up to `peak` in a straight line over `warm_up` steps, then down a cosine to `floor` of
    it at the last of `steps`. A function of the step, so that nothing of it has to be resumed."""
    warm_up = min(warm_up, steps)
    if step < warm_up:
        return peak * (step + 1) / warm_up
    done = (step - warm_up + 1) / max(steps - warm_up, 1)
    return peak * (floor + (1 - floor) * 0.5 * (1 + math.cos(math.pi * min(done, 1.0))))


def set_rate(optimiser: torch.optim.Optimizer, rate: float) -> None:
    """Gives all groups of an optimiser a learning rate."""
    for group in optimiser.param_groups:
        group["lr"] = rate


@dataclass
class Checkpoint:
    """A training run as it stands: enough to go on as if it had never stopped.

    step:      steps done
    settings:  what the run was asked for; a run goes on only under the same
    model:     state of the network; optimiser: state of the optimiser
    seconds:   time trained so far, over all its parts
    log:       what was measured on the way, a mapping for each measurement
    """

    step: int
    settings: dict[str, Value]
    model: dict[str, Any]
    optimiser: dict[str, Any]
    seconds: float = 0.0
    log: list[dict[str, Value]] = field(default_factory=list)

    def require(self, settings: Mapping[str, Value], may_differ: frozenset[str] = frozenset()) -> None:
        """Checks that this is a run under `settings`; those named in `may_differ` need not be the same.

        Raises SettingsError that names the first one that is not.
        """
        for name in sorted(self.settings.keys() | settings.keys()):
            then, now = self.settings.get(name), settings.get(name)
            if then != now and name not in may_differ:
                raise SettingsError(
                    f"the run to resume has {name} = {then!r}, not {now!r}: give the same, or another folder", name
                )


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Writes a checkpoint whole or not at all: beside `path` first, then renamed.

    Raises SourceError when it cannot be written.
    """
    values = {"kind": _KIND, "version": _VERSION, **vars(checkpoint)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SourceError(f"cannot write {path}: {error.strerror or error}") from None
    content = io.BytesIO()
    torch.save(values, content)  # not to the file: where the disk is full, torch raises what does not say so
    with written_whole(path) as beside:
        beside.write_bytes(content.getbuffer())


def _check_names(archive: ZipFile) -> None:
    """Raises ArraysRefusedError when a checkpoint names anything but tensors: torch would also build a `bytearray` of
    any length, from a number."""
    for member in archive.namelist():
        if not member.endswith("data.pkl"):
            continue
        for opcode, argument, _ in pickletools.genops(archive.read(member)):
            known = argument in _NAMES or (isinstance(argument, str) and _STORAGE.fullmatch(argument))
            if opcode.name in _LOOKUPS and not (opcode.name == "GLOBAL" and known):
                raise ArraysRefusedError("it names what no checkpoint holds")


def _check_tensors(values: object) -> None:
    """Raises ArraysRefusedError for a tensor that says it has more numbers than are stored."""
    left = [values]
    while left:
        one = left.pop()
        if isinstance(one, torch.Tensor):
            if one.numel() * one.element_size() > one.untyped_storage().nbytes():
                raise ArraysRefusedError("it has a tensor that is larger than what is stored of it")
        elif isinstance(one, Mapping):
            left.extend(one.values())
        elif isinstance(one, list | tuple):
            left.extend(one)


def load_checkpoint(path: Path, device: torch.device | None = None) -> Checkpoint | None:
    """The checkpoint at `path`, its tensors on `device` (else the CPU); None if there is none.

    Only numbers, text and tensors are read: a file from a stranger cannot run code.
    Raises SourceError when the file is no checkpoint, or one of another version.
    """
    if not path.exists():
        return None
    damaged = f"{path} is not a checkpoint, or a damaged one: remove it to begin anew"
    try:
        with open_regular(path) as file, check_archive(file, largest("checkpoint") or 0, stored=True) as archive:
            _check_names(archive)  # no archive: one of torch's older forms, which are never written here
        values = torch.load(path, map_location=device or "cpu", weights_only=True)
        _check_tensors(values)
    except OSError as error:
        raise SourceError(f"cannot read the checkpoint {path}: {error.strerror or error}") from None
    except Exception:  # a damaged archive may raise anything at all
        raise SourceError(damaged) from None
    if not isinstance(values, dict) or values.pop("kind", None) != _KIND:
        raise SourceError(f"{path} is not a checkpoint of a training run")
    version = values.pop("version", None)
    if version != _VERSION:
        raise SourceError(f"{path} is a checkpoint of version {version}; this program reads {_VERSION}")
    try:
        return Checkpoint(**values)
    except TypeError:
        raise SourceError(f"{path} is a damaged checkpoint: remove it to begin anew") from None
