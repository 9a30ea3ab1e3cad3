"""`python tools/sensor_tables.py` writes native/src/sensors/model_tables.cpp: what the native decoder knows of models
that send blocks. `tests/sensors/test_native_tables.py` compares it with lidarcodec/sensors/models.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from lidarcodec.sensors.models.block_sensor import BlockSensor
from lidarcodec.sensors.models.blocks import BlockLayout
from lidarcodec.sensors.models.hesai_packet import HesaiSensor
from lidarcodec.sensors.models.qt128 import LOOP_1_NS, LOOP_2_NS, Qt128
from lidarcodec.sensors.models.table import block_sensors
from lidarcodec.sensors.models.velodyne_packet import VelodyneSensor
from lidarcodec.sensors.models.vls128 import Vls128

TARGET: Final = Path(__file__).resolve().parent.parent / "native/src/sensors/model_tables.cpp"
HEAD: Final = """// Written by tools/sensor_tables.py from lidarcodec/sensors/models: sources of all numbers are there.
#include "sensors/block_model.hpp"

namespace lidarcodec {
namespace {

"""
KINDS: Final[dict[type[BlockSensor], str]] = {
    VelodyneSensor: "Velodyne",
    Vls128: "Vls128",
    HesaiSensor: "Hesai",
    Qt128: "Qt128",
}
"""Class of a model -> BlockKind of native/src/sensors/block_model.hpp, whose code does what the class does."""


class Tables:
    """Constants of the file; equal ones are written once."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._names: dict[tuple[str, str], str] = {}

    def array(self, kind: str, prefix: str, items: Sequence[str]) -> str:
        """Name of the constant that holds these; `{}` of none."""
        if not items:
            return "{}"
        text = ", ".join(items)
        if (kind, text) not in self._names:
            name = f"k{prefix}{len(self._names)}"
            self._names[kind, text] = name
            self.lines.append(f"constexpr {kind} {name}[] = {{{text}}};\n")
        return self._names[kind, text]


def kind_of(sensor: BlockSensor) -> str:
    """Of enum BlockKind. Raises TypeError for a class that the native decoder does not have."""
    kind = type(sensor)
    if kind not in KINDS:
        raise TypeError(
            f"{sensor.name}: the native decoder has nothing for {kind.__name__}. Write it in native/src/sensors, "
            "give it a BlockKind, and name that in KINDS of tools/sensor_tables.py"
        )
    return KINDS[kind]


def layout_of(tables: Tables, sensor: BlockSensor, layout: BlockLayout) -> str:
    """A PacketLayout."""
    series = [f'{{"{name}", {dtype.itemsize}, {each}}}' for name, (dtype, each) in layout.series.items()]
    times = sensor.column_ns(layout).tolist() if isinstance(sensor, HesaiSensor) else []
    parts = [
        f'"{layout.name}"',
        str(layout.columns),
        str(layout.blocks // layout.group),
        str(layout.returns == 2).lower(),
        tables.array("SeriesPlan", "Series", series),
        tables.array("std::int32_t", "Times", list(map(str, times))),
    ]
    return "{" + ", ".join(parts) + "}"


def model_of(tables: Tables, sensor: BlockSensor) -> str:
    """A BlockModel."""
    channels = tables.array("std::uint8_t", "Channels", [str(one) for one in sensor.channel_of_row.tolist()])
    layouts = tables.array("PacketLayout", "Layouts", [layout_of(tables, sensor, one) for one in sensor.layouts])
    turning, firing = "0, 0, 1", ((), ())
    if isinstance(sensor, VelodyneSensor):
        turning = f"{sensor.cycle_us!r}, {sensor.shot_us!r}, {sensor.together}"
    if isinstance(sensor, HesaiSensor):
        firing = (LOOP_1_NS, LOOP_2_NS) if isinstance(sensor, Qt128) else (sensor.channel_ns, ())
    loops = ", ".join(tables.array("std::int32_t", "Times", list(map(str, one))) for one in firing)
    step = round(sensor.range_step_m * 1e7)
    return f'{{"{sensor.name}", BlockKind::{kind_of(sensor)}, {step}, {channels}, {layouts}, {turning}, {loops}}}'


def text() -> str:
    """The file, not yet in the house's form."""
    tables = Tables()
    models = [model_of(tables, sensor) for sensor in block_sensors()]
    tables.array("BlockModel", "Models", models)
    name = tables.lines[-1].split()[2].removesuffix("[]")
    models_of = f"std::span<const BlockModel> block_models() {{ return {name}; }}\n"
    return HEAD + "".join(tables.lines) + f"\n}}  // namespace\n\n{models_of}\n}}  // namespace lidarcodec\n"


def main() -> None:
    """Write the file."""
    TARGET.write_text(text())
    subprocess.run([Path(sys.executable).parent / "clang-format", "-i", TARGET], check=True)


if __name__ == "__main__":
    main()
