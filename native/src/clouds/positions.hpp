// x, y and z of the points of a cloud: a range n, a direction k, and what is left of each coordinate
// (docs/wire-format-clouds.md, "Positions"); in Python lidarcodec/planes/clouds/positions.py.
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/bytes.hpp"
#include "clouds/geometry.hpp"

namespace lidarcodec {

// What is left of a coordinate: units in the last place, steps of 1 / unit, or steps of unit metres.
enum class LeftForm : std::uint8_t { LastPlaces, Decimals, Metres };

struct LeftUnit {
  LeftForm form = LeftForm::LastPlaces;
  double unit = 1;
};

// Cells of N points in a range image, in the order of the points.
struct CloudCells {
  std::size_t rows = 0, columns = 0;
  std::span<const std::int64_t> row, column;
};

// Raises Section for points beyond the rows and columns.
void check_cells(const CloudCells& cells);

using Coordinates = std::array<std::vector<float>, 3>;  // x, y and z, (N,) each

// A point is coded by its numbers, apart by its bytes, or is one without a return, of which the bits are known.
enum class PointState : std::uint8_t { Coded, Apart, Empty };

struct CodedPositions {
  std::vector<std::uint8_t> bytes;
  std::vector<PointState> states;
  std::vector<std::uint32_t> n;  // range of each point; 0: Empty
  std::vector<std::int32_t> k;   // direction
  bool by_column = true;         // whether directions are told by columns
  double bits = 0;               // of directions and coordinates of a point, roughly
};

// What an encoder knows of the points.
struct GivenPositions {
  std::array<std::span<const float>, 3> xyz;
  std::span<const std::uint8_t> returned;            // of each point, whether it has a return
  std::span<const std::uint32_t> n;                  // ranges, if the message has them beside; else none
  std::span<const std::int32_t> k;                   // directions, if they are known; else none
  std::optional<std::array<std::uint32_t, 3>> none;  // bits of points without a return
  bool by_column = false;                            // whether directions are known to be told well by columns
  double bound_m = 0;  // of Metres: the largest distance between a point and what comes back
};

// Raises Section unless the sizes fit.
CodedPositions encode_positions(const CloudCells& cells, const CloudGeometry& geometry, const LeftUnit& unit,
                                const GivenPositions& given);

struct DecodedPositions {
  Coordinates xyz;  // of n = 0: 0
  std::vector<std::int32_t> k;
};

// The inverse. n: of each point. Raises Section or Truncated.
DecodedPositions decode_positions(Bytes data, const CloudCells& cells, const CloudGeometry& geometry,
                                  const LeftUnit& unit, std::span<const std::uint32_t> n);

}  // namespace lidarcodec
