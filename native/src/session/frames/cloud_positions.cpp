#include "session/frames/cloud_positions.hpp"

#include <algorithm>
#include <cmath>

#include "base/varint.hpp"
#include "session/frames/rest.hpp"

namespace lidarcodec {
namespace {

constexpr double kLeastUnit = 1e-9, kMostStep = 1e3, kMostUnit = 1e6, kFarthestTurned = 4294967296.0;
constexpr std::uint32_t kMostTurn = 1u << 28;
constexpr double kFine = 0x1p-36, kCoarse = 0x1p-28;  // units of numbers of rows

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

double number_of(VarintReader& reader) { return std::bit_cast<double>(little_endian(reader.take(8), 0, 8)); }

CloudGeometry read_geometry(VarintReader& reader, std::size_t rows, LeftUnit& unit) {
  CloudGeometry geometry;
  const std::uint8_t narrow = reader.byte();
  geometry.step_m = number_of(reader);
  geometry.turn = static_cast<std::uint32_t>(little_endian(reader.take(4), 0, 4));
  geometry.angles = reader.byte();
  const std::uint8_t left = reader.byte();
  unit = {static_cast<LeftForm>(left), number_of(reader)};
  const bool known = narrow <= 1 && geometry.angles < kAngleForms.size() &&
                     left <= static_cast<std::uint8_t>(LeftForm::Metres) && geometry.turn >= 1 &&
                     geometry.turn <= kMostTurn;
  const auto within = [](double value, double most) { return value > kLeastUnit && value < most; };
  if (!known || !within(geometry.step_m, kMostStep) || !within(unit.unit, kMostUnit))
    damaged("a geometry of " + std::to_string(geometry.turn) + " steps of a turn, or with units beyond the limits");
  geometry.narrow = narrow == 1;
  const std::vector<std::int64_t> values = signed_numbers(reader.sized(), std::vector<std::size_t>(6, rows));
  for (std::size_t row = 0; row < rows; ++row) {
    const auto value = [&](std::size_t series, double scale) {
      return static_cast<double>(values[series * rows + row]) * scale;
    };
    geometry.rows.push_back(
        {value(0, kFine), value(1, kCoarse), value(2, kFine), value(3, kCoarse), value(4, kCoarse), value(5, kCoarse)});
    if (std::abs(geometry.rows.back().turned) >= kFarthestTurned)
      damaged("a row that is turned by more than any sensor's");
  }
  return geometry;
}

// Points whose coordinates are sent as they are.
void read_apart(VarintReader& reader, std::span<const std::uint32_t> n, const Outside& outside, Coordinates& xyz) {
  const std::uint8_t has_none = reader.byte();
  if (has_none == 1) {
    const Bytes none = reader.take(12);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto value = std::bit_cast<float>(static_cast<std::uint32_t>(little_endian(none, 4 * axis, 4)));
      for (std::size_t i = 0; i < n.size(); ++i)
        if (n[i] == 0) xyz[axis][i] = value;
    }
  }
  const std::size_t count = reader.number(n.size());
  if (has_none > 1) damaged("a mark of points without a return that is neither 0 nor 1");
  if (count == 0) return;
  const std::vector<std::int64_t> passed = signed_numbers(reader.sized(), {count});
  std::vector<std::size_t> places;
  std::size_t next = 0;
  for (const std::int64_t one : passed) {
    if (one < 0 || one >= static_cast<std::int64_t>(n.size() - next))
      damaged("a point apart beyond the points of the cloud");
    places.push_back(next + static_cast<std::size_t>(one));
    next = places.back() + 1;
  }
  const std::vector<std::uint8_t> values = zstd_frame(outside, reader.sized(), 12 * count);
  for (std::size_t axis = 0; axis < 3; ++axis)
    for (std::size_t i = 0; i < count; ++i)
      xyz[axis][places[i]] =
          std::bit_cast<float>(static_cast<std::uint32_t>(little_endian(values, 4 * (axis * count + i), 4)));
}

}  // namespace

ReadPositions read_positions(Bytes data, const CloudCells& cells, std::span<const std::uint32_t> n,
                             const Outside& outside) {
  VarintReader reader(data, "positions of a cloud");
  ReadPositions positions;
  LeftUnit unit;
  positions.geometry = read_geometry(reader, cells.rows, unit);
  positions.found = decode_positions(reader.sized(), cells, positions.geometry, unit, n);
  read_apart(reader, n, outside, positions.found.xyz);
  reader.end();
  return positions;
}

}  // namespace lidarcodec
