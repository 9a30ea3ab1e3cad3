"""StreamSettings: settings of a stream, one model for command line, Zenoh and REST.

`codec_settings` is a plain mapping here; `codecs.table` checks it against the codec's own model.

>>> StreamSettings(codec="pcodec", max_error_m=0.01).step
11
"""

from __future__ import annotations

import ast
import inspect
import math
import re
import textwrap
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, Literal, TypedDict, Unpack

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, field_validator, model_validator

from lidarcodec.errors import SettingsError, sentence_of, unknown_name
from lidarcodec.units import FRAME_PACKETS, MAX_PACKETS, RANGE_STEP_M

if TYPE_CHECKING:
    from pydantic import GetJsonSchemaHandler
    from pydantic.json_schema import JsonSchemaValue
    from pydantic_core import CoreSchema

NAME_PATTERN = re.compile(r"\.{0,63}[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}")
MAX_NAME = 64
"""Longest name, in characters. Names become parts of keys and paths, so a name of dots alone is refused."""
MAX_BOUND_M = 20.0
MAX_KBPS = 1e6
MAX_PARTS: Final = 8
"""Most parts of a turn."""
AUTO: Literal["auto"] = "auto"
"""As target: the bitrate that the network carries, measured while the stream runs. As intensity or reduction: as much
as the target bitrate allows, all without a target."""
LATTICE: Final = "lattice"
MORE: Final[dict[str, JsonValue]] = {"more": True}
"""Mark in a setting's JSON schema: forms show the setting among the advanced ones."""
Purpose = Literal["look", "localise", "detect", "archive"]
UNFILLED: Final[tuple[Purpose, ...]] = ("localise", "detect")
"""Purposes for which receivers do not interpolate returns."""
Shape = Literal["rounded", "free"]


def step_of(max_error_m: float, range_step_m: float = RANGE_STEP_M) -> int:
    """Quantiser width in range steps of the sensor that keeps every error within `max_error_m`; 1 = lossless.

    It is 2 * floor(e / range step + 1e-6) + 1: a step of 2 k + 1 has errors of at most k. The term 1e-6 is for bounds
    such as 0.086, which have no exact binary value.
    """
    return 2 * math.floor(max_error_m / range_step_m + 1e-6) + 1


class SettingChanges(TypedDict, total=False):
    """Fields of StreamSettings as keyword arguments, for type checkers and editors."""

    codec: str
    codec_settings: dict[str, Any]
    purpose: Purpose
    max_error_m: float | None
    target_kbps: float | Literal["auto"] | None
    intensity: str
    reduction: str
    keep_points: int | None
    keep_fraction: float | None
    framing: str
    key_interval: int
    shape: Shape
    base_error_m: float | None
    follow: str | None


class Described(BaseModel):
    """A model whose JSON schema describes each field by the docstring below it.

    The source is read when a schema is asked for. Pydantic's own option reads it at each start of the program.
    """

    @classmethod
    def __get_pydantic_json_schema__(cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler(core_schema)
        fields = handler.resolve_ref_schema(schema).get("properties", {})
        for name, text in _docstrings(cls).items():
            if name in fields:
                fields[name].setdefault("description", text)
        return schema


@cache
def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """The docstring below each field, also of the classes that a model is made of. Without the source: none."""
    found: dict[str, str] = {}
    for part in reversed(model.__mro__):
        if not issubclass(part, Described) or part is Described:
            continue
        try:
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(part))).body
        except OSError:
            continue
        for field, text in pairwise(tree.body if isinstance(tree, ast.ClassDef) else ()):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
                and isinstance(text.value.value, str)
            ):
                found[field.target.id] = inspect.cleandoc(text.value.value)
    return found


class StreamSettings(Described):
    """Settings common to all codecs. Frozen; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    if not TYPE_CHECKING:  # type checkers and editors know the fields from their own lines

        def __init__(self, /, **values: Any) -> None:
            """Raises SettingsError with the field and the reason."""
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise _refusal(error) from None

    codec: str = "pcodec"
    """The codec. A new codec starts with its own default settings. `auto`: the codec with the best picture at the
    target, of those that are fast enough on this machine."""
    codec_settings: dict[str, Any] = Field(default_factory=dict)
    """The codec's own settings."""
    purpose: Purpose = "look"
    """What matters most at a target bitrate. `look`: the picture for people. `localise`: few returns with a small error
    bound, chosen for localisation. `detect`: near and small objects. `archive`: all returns; only intensity and error
    bound are adjusted."""
    max_error_m: float | None = Field(default=None, ge=0.0, le=MAX_BOUND_M)
    """Largest error of any range, in metres, at most 20. 0: lossless. null: the default of the codec."""
    target_kbps: float | Literal["auto"] | None = None
    """Largest mean bitrate over any five seconds, in kbit/s. To keep it, the program adjusts the error bound or the
    quality. `auto`: follow the bitrate of the network."""
    intensity: str = AUTO
    """`auto`, `lossless`, `error=N`, `levels=N` or `off`. `error=N` (1 to 127): errors of at most N, of 255.
    `levels=N` (2 to 256): at most N different values in a frame. `auto`: adjusted to the target bitrate; lossless
    without a target."""
    reduction: str = AUTO
    """Which returns are sent. `auto`: as many columns as the target bitrate allows; all without a target."""
    keep_points: int | None = Field(default=None, ge=1)
    """Number of returns that a reduction keeps in each frame."""
    keep_fraction: float | None = Field(default=None, gt=0.0, le=1.0)
    """Share of the returns that a reduction keeps in each frame. It replaces `keep_points`."""
    framing: str = Field(default="revolution", json_schema_extra=MORE)
    """Size of a frame: `revolution` (a turn), `packets` (348 packets, about a turn), `packets:N` (N packets), or
    `parts:N`: a turn is sent in N parts (2 to 8), each while the next is measured. Later parts are shorter."""
    key_interval: int = Field(default=50, ge=1, le=100_000, json_schema_extra=MORE)
    """Number of frames from one key frame to the next."""
    shape: Shape = Field(default="free", json_schema_extra=MORE)
    """How `riddle` and `predictive` use an error bound. `free`: each return gets a value within the bound that costs
    few bits. `rounded`: each return gets the nearest value of a fixed grid."""
    base_error_m: float | None = Field(default=None, gt=0.0, le=MAX_BOUND_M, json_schema_extra=MORE)
    """Two layers: messages with this error bound, in metres, at most 20, and refinements of them to `max_error_m`, one
    for each twelfth of a turn. Without `max_error_m`, or with 0, refined packets are exact. null: one layer."""
    follow: str | None = Field(default=None, json_schema_extra=MORE)
    """Name of the receiver whose arrival reports control the stream. null: chosen automatically."""

    @field_validator(
        "max_error_m", "base_error_m", "target_kbps", "keep_points", "keep_fraction", "key_interval", mode="before"
    )
    @classmethod
    def _number(cls, value: Any) -> Any:
        if isinstance(value, bool):  # pydantic would take true for 1: a bound of a metre
            raise ValueError("write a number, not true or false")  # noqa: TRY004 (pydantic takes no other)
        if isinstance(value, str) and value != AUTO:  # pydantic would take "5" for 5, which the schema does not allow
            raise ValueError("write a number, not text")
        return value

    @field_validator("intensity")
    @classmethod
    def _intensity(cls, value: str) -> str:
        if value in (AUTO, "lossless", "off"):
            return value
        found = re.fullmatch(r"(levels|error)=([0-9]{1,3})", value)
        if found and int(found[2]) in (range(2, 257) if found[1] == "levels" else range(1, 128)):
            return value
        raise ValueError(
            "intensity must be auto, lossless, off, error=N with N from 1 to 127, or levels=N with N from 2 to 256"
        )

    @field_validator("target_kbps")
    @classmethod
    def _target(cls, value: float | str | None) -> float | str | None:
        if isinstance(value, float) and not 1.0 <= value <= MAX_KBPS:
            raise ValueError(f"a target must be 1 to {MAX_KBPS:.0f} kbit/s")
        return value

    @field_validator("framing")
    @classmethod
    def _framing(cls, value: str) -> str:
        if value in ("packets", "revolution"):
            return value
        found = re.fullmatch(r"(packets|parts):([0-9]{1,4})", value)
        least, most = (2, MAX_PARTS) if found and found[1] == "parts" else (1, MAX_PACKETS)
        if not found or not least <= int(found[2]) <= most:
            raise ValueError(
                f"framing must be revolution, packets, packets:N with N from 1 to {MAX_PACKETS}, "
                f"or parts:N with N from 2 to {MAX_PARTS}"
            )
        return value

    @field_validator("follow")
    @classmethod
    def _follow(cls, value: str | None) -> str | None:
        if value is not None and not is_name(value):
            raise ValueError("follow must be the name of a receiver: 1 to 64 of A-Z a-z 0-9 _ . -")
        return value

    @model_validator(mode="after")
    def _one_budget(self) -> StreamSettings:
        if self.keep_points is not None and self.keep_fraction is not None:
            raise ValueError("give keep_points or keep_fraction, not both")
        return self

    @model_validator(mode="after")
    def _two_layers(self) -> StreamSettings:
        if self.base_error_m is not None:
            if step_of(self.base_error_m) <= self.step:
                raise ValueError(
                    f"base_error_m={self.base_error_m:g} is too small: it must be larger than max_error_m, and "
                    "at least 0.002 m"
                )
            if self.codec == AUTO:
                raise ValueError("codec auto does not support base_error_m: choose a codec by name")
            if self.target_kbps is not None:
                raise ValueError("base_error_m cannot be combined with a target bitrate: leave out target_kbps")
            if self.reduces:
                raise ValueError(
                    "base_error_m cannot be combined with a reduction, because refinements bring "
                    "all returns: leave out reduction"
                )
        return self

    @model_validator(mode="after")
    def _whole_parts(self) -> StreamSettings:
        if self.parts > 1:
            if self.codec == AUTO:
                raise ValueError(f"framing={self.framing} does not work with codec auto: choose a codec by name")
            if self.target_kbps is not None or self.base_error_m is not None or self.reduces:
                raise ValueError(
                    f"framing={self.framing} sends every return exactly as settings say: leave out target_kbps, "
                    "base_error_m and reduction"
                )
        return self

    @property
    def parts(self) -> int:
        """Parts in which a turn is sent; 1 for whole frames."""
        return int(self.framing.removeprefix("parts:")) if self.framing.startswith("parts:") else 1

    @property
    def base(self) -> StreamSettings:
        """The settings that messages are coded with: with `base_error_m` those of the base, else these."""
        if self.base_error_m is None:
            return self
        return self.model_copy(update={"max_error_m": self.base_error_m, "base_error_m": None})

    @property
    def step(self) -> int:
        """Quantiser width of ranges in native steps; 1 = lossless."""
        return 1 if self.max_error_m is None else step_of(self.max_error_m)

    @property
    def is_free(self) -> bool:
        """Whether `shape` is `free` and the bound leaves a choice of values (a step above 1)."""
        return self.shape == "free" and self.step > 1

    @property
    def intensity_levels(self) -> int:
        """Number of intensity levels sent: 256 = lossless, 0 = off. `auto` counts as lossless.

        For `error=N` it is the fewest levels that represent 0 to 255 with errors of at most N.
        """
        fixed = {AUTO: 256, "lossless": 256, "off": 0}
        if self.intensity in fixed:
            return fixed[self.intensity]
        if self.intensity_error:
            return 255 // (2 * self.intensity_error + 1) + 1
        return int(self.intensity.removeprefix("levels="))

    @property
    def intensity_error(self) -> int:
        """N of `error=N`, the largest error of an intensity byte; 0 for any other choice."""
        name, _, number = self.intensity.partition("=")
        return int(number) if name == "error" else 0

    @property
    def reduces(self) -> bool:
        """Whether a particular reduction is set: not `auto`, not `all`."""
        return self.reduction not in (AUTO, "all")

    @property
    def frame_packets(self) -> int | None:
        """Packets in a frame, None for whole revolutions and their parts."""
        if self.framing == "revolution" or self.parts > 1:
            return None
        return int(self.framing.partition(":")[2] or FRAME_PACKETS)

    def changed(self, /, **changes: Unpack[SettingChanges]) -> StreamSettings:
        """These settings with some fields changed; a new codec starts with its own default settings.

        Raises SettingsError, and changes nothing, if any of it is not allowed.
        """
        merged = self.model_dump() | dict(changes)
        if changes.get("codec", self.codec) != self.codec and "codec_settings" not in changes:
            merged["codec_settings"] = {}
        return settings_from(merged)


def settings_from(values: dict[str, Any]) -> StreamSettings:
    """StreamSettings from plain values.

    Raises SettingsError with the field and the reason.
    """
    try:
        return StreamSettings.model_validate(values)
    except ValidationError as error:  # not a mapping
        raise _refusal(error) from None


def _refusal(error: ValidationError) -> SettingsError:
    """The first of the errors, as ours."""
    first = error.errors()[0]
    field = str(first["loc"][0]) if first["loc"] else None
    if first["type"] == "extra_forbidden":
        return SettingsError(unknown_name("setting", str(field), StreamSettings.model_fields), field)
    return SettingsError(sentence_of(field or "settings", first), field)


def is_name(text: str) -> bool:
    """Whether a text may be the name of a vehicle, a sensor or a receiver."""
    return len(text) <= MAX_NAME and NAME_PATTERN.fullmatch(text) is not None


def valid_name(name: str, what: str) -> str:
    """The name itself, if it may be used in a key expression.

    Raises SettingsError otherwise.
    """
    if not is_name(name):
        raise SettingsError(
            f"{what} '{name[:80]}' is not a valid name: use 1 to {MAX_NAME} letters (A-Z a-z), digits, _ . or "
            "-, and not only dots",
            what,
        )
    return name
