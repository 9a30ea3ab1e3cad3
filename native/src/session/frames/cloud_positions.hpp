// Positions of a CLOUD section (docs/wire-format-clouds.md, "Positions"); lidarcodec/planes/clouds/positions.py writes
// them.
#pragma once
#include "clouds/positions.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

struct ReadPositions {
  CloudGeometry geometry;
  DecodedPositions found;
};

// x, y and z of the points of an image. n: of each point. Raises Section or Truncated.
ReadPositions read_positions(Bytes data, const CloudCells& cells, std::span<const std::uint32_t> n,
                             const Outside& outside);

}  // namespace lidarcodec
