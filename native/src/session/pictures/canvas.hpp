// The canvas of pictures of an HDL-64E (docs/wire-format.md, "Canvas"), in Python lidarcodec/ranges/image/canvas.py.
#pragma once
#include <array>
#include <utility>

#include "session/planes.hpp"

namespace lidarcodec {

// Where the cells of a frame lie on its canvas.
struct Canvas {
  std::size_t width = 0;
  std::array<std::size_t, kRows> shift{};             // first column of each row
  std::array<std::vector<std::uint32_t>, 2> columns;  // (W,) of each half: which one of its own a column is

  std::size_t place(const Sensor& sensor, std::size_t row, std::size_t column) const {
    return row * width + shift[row] + columns[sensor.beams.half[row]][column];
  }
};

// The angle by which each row lies beside the first, 1e-8 rad: more than half a turn to either side never.
std::array<std::int64_t, kRows> angles_of_rows(const Sensor& sensor);

// The canvas of a RANGE section, and what follows its head; the width is a multiple of `multiple`. Raises Section.
std::pair<Canvas, Bytes> split_canvas(Bytes data, const Sensor& sensor, const Planes& planes, std::size_t multiple);

}  // namespace lidarcodec
