#include "session/pictures/canvas.hpp"

#include <algorithm>
#include <string>

namespace lidarcodec {
namespace {

constexpr std::size_t kHeadBytes = 9;
constexpr std::uint8_t kCompact = 1;
constexpr std::int64_t kTurn = 628'318'531, kHalfTurn = kTurn / 2, kMostSpan = 1024;

std::int64_t floor_quotient(std::int64_t value, std::int64_t by) {
  return value / by - static_cast<std::int64_t>(value % by < 0);
}

// Columns in order, or, where the canvas is compact, those with a return in any row of the half.
std::vector<std::uint32_t> places_of(const Sensor& sensor, const Planes& planes, std::size_t half, bool compact) {
  std::vector<std::uint32_t> used(planes.width, compact ? 0 : 1);
  for (std::size_t row = 0; compact && row < kRows; ++row)
    for (std::size_t c = 0; sensor.beams.half[row] == half && c < planes.width; ++c)
      used[c] |= planes.returns[row * planes.width + c];
  std::uint32_t next = 0;
  for (std::uint32_t& one : used) {
    const std::uint32_t place = next;
    next += one;
    one = place;
  }
  used.push_back(next);  // their number
  return used;
}

}  // namespace

std::array<std::int64_t, kRows> angles_of_rows(const Sensor& sensor) {
  std::array<std::int64_t, kRows> angles;
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::int64_t off = std::int64_t{sensor.beams.rotation[0]} - sensor.beams.rotation[row] + kHalfTurn;
    angles[row] = off - floor_quotient(off, kTurn) * kTurn - kHalfTurn;
  }
  return angles;
}

std::pair<Canvas, Bytes> split_canvas(Bytes data, const Sensor& sensor, const Planes& planes, std::size_t multiple) {
  if (data.size() < kHeadBytes)
    throw Error(ErrorCode::Section,
                "a range section of " + std::to_string(data.size()) + " bytes ends before its canvas is known");
  if ((data[0] & ~kCompact) != 0)
    throw Error(ErrorCode::Section, "a canvas with unknown flags " + std::to_string(data[0]));
  const std::array<std::int64_t, 2> apart = {static_cast<std::int64_t>(little_endian(data, 1, 4)),
                                             static_cast<std::int64_t>(little_endian(data, 5, 4))};
  const std::array<std::int64_t, kRows> angle = angles_of_rows(sensor);
  std::array<std::int64_t, kRows> shift{};
  for (std::size_t row = 0; row < kRows; ++row)
    if (const std::int64_t of = apart[sensor.beams.half[row]]; of > 0)
      shift[row] = floor_quotient(2 * angle[row] + of, 2 * of);
  const auto [least, largest] = std::minmax_element(shift.begin(), shift.end());
  if (*largest - *least > kMostSpan)
    throw Error(ErrorCode::Section, "a canvas that spreads over " + std::to_string(*largest - *least) +
                                        " columns: " + std::to_string(kMostSpan) + " are possible");
  Canvas canvas;
  for (std::size_t half = 0; half < 2; ++half)
    canvas.columns[half] = places_of(sensor, planes, half, (data[0] & kCompact) != 0);
  for (std::size_t row = 0; row < kRows; ++row) {
    canvas.shift[row] = static_cast<std::size_t>(shift[row] - *least);
    canvas.width = std::max(canvas.width, canvas.shift[row] + canvas.columns[sensor.beams.half[row]].back());
  }
  canvas.width = (canvas.width + multiple - 1) / multiple * multiple;
  return {std::move(canvas), data.subspan(kHeadBytes)};
}

}  // namespace lidarcodec
