"""The reducers by name. Modules are imported at first use. A new reducer is one file and one line here.

>>> from lidarcodec.settings import StreamSettings
>>> make_reducer(StreamSettings(reduction="columns:4")).argument
'4'
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Final, NamedTuple, cast

from lidarcodec.errors import SettingsError
from lidarcodec.reduction.base import DEFAULT_SEED, Budget, Reducer, Reduction
from lidarcodec.settings import StreamSettings


class Entry(NamedTuple):
    """module: module with `REDUCTION`; package: a package that only it needs; extra: the extra with this package"""

    module: str
    package: str | None = None
    extra: str | None = None


_TABLE: Final = {
    "auto": Entry("lidarcodec.reduction.keep_all"),
    "all": Entry("lidarcodec.reduction.keep_all"),
    "lattice": Entry("lidarcodec.reduction.lattice"),
    "columns": Entry("lidarcodec.reduction.columns"),
    "random": Entry("lidarcodec.reduction.random_points"),
    "voxel": Entry("lidarcodec.reduction.voxel"),
    "voxel-seen": Entry("lidarcodec.reduction.voxel_seen"),
    "poconet": Entry("lidarcodec.reduction.poconet", "onnxruntime", "poconet"),
    "poconet-paper": Entry("lidarcodec.reduction.poconet_paper", "onnxruntime", "poconet"),
}


def names() -> tuple[str, ...]:
    """Names of all installed reducers. `columns` and `lattice` need a number, as in `lattice:4`."""
    return tuple(name for name in _TABLE if _is_offered(name))


def _is_offered(name: str) -> bool:
    package = _TABLE[name].package
    return package is None or find_spec(package) is not None


def entries() -> dict[str, Entry]:
    """The table entries by name."""
    return dict(_TABLE)


@cache
def reduction(name: str) -> Reduction:
    """The table entry of a reducer. name: without an argument.

    Raises SettingsError.
    """
    if name not in _TABLE:
        known = ", ".join(f"{other}:n" if reduction(other).argument else other for other in names())
        raise SettingsError(f"unknown reduction '{name}': choose one of {known}", "reduction")
    if not _is_offered(name):
        raise SettingsError(
            f"reduction {name} needs {_TABLE[name].package}, which is not installed: "
            f"pip install 'lidarcodec[{_TABLE[name].extra}]'",
            "reduction",
        )
    return cast(Reduction, import_module(_TABLE[name].module).REDUCTION)


def _parts(text: str) -> tuple[str, str | None]:
    name, colon, argument = text.partition(":")
    return name, argument if colon else None


def check(settings: StreamSettings) -> StreamSettings:
    """The settings themselves, if their reduction exists and their budget applies to it.

    Raises SettingsError with the field and the reason.
    """
    name, argument = _parts(settings.reduction)
    chosen = reduction(name)
    if argument is not None and chosen.argument is None:
        raise SettingsError(
            f"reduction {name} takes no value after a colon: '{settings.reduction}' is not allowed", "reduction"
        )
    if chosen.argument is not None:
        try:
            chosen.argument(argument or "")
        except ValueError as error:
            raise SettingsError(f"reduction '{settings.reduction}': {error}", "reduction") from None
    for field in ("keep_points", "keep_fraction"):
        if getattr(settings, field) is not None and not chosen.budgeted:
            able = ", ".join(other for other in names() if reduction(other).budgeted)
            raise SettingsError(f"{field} has no effect on reduction '{settings.reduction}': leave it out, or "
f"choose one of {able}", field)  # fmt: skip
    return settings


def make_reducer(settings: StreamSettings, seed: int = DEFAULT_SEED) -> Reducer:
    """Make a reducer.

    Raises the errors of `check`.
    """
    name, argument = _parts(check(settings).reduction)
    return reduction(name).make(budget_of(settings), argument, seed)


def budget_of(settings: StreamSettings) -> Budget:
    """The budget in the settings."""
    return Budget(settings.keep_points, settings.keep_fraction)


def example_of(name: str) -> str:
    """A value of the setting `reduction` for this reducer: `columns:4` for `columns`, `voxel` for `voxel`.

    Raises SettingsError.
    """
    example = reduction(name).example
    return name if example is None else f"{name}:{example}"


def note_of(name: str) -> str | None:
    """The warning for operators about a reduction; None if there is none. name: with its argument, if it has one"""
    return reduction(_parts(name)[0]).note
