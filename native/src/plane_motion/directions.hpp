// The directions in which the cells of planes look, as they travel with frames that follow each other.
// docs/wire-format-planes.md, "Motion", has the format.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/bytes.hpp"
#include "motion/fixed_angle.hpp"

namespace lidarcodec {

// Of the beam of each row, in steps of 2^-20 of a turn: up from the horizon, falling from row to row, and aside from
// the direction of its column, clockwise. Empty: not known.
struct PlaneBeams {
  std::vector<std::int32_t> up, aside;

  bool known() const { return !up.empty(); }
  friend bool operator==(const PlaneBeams&, const PlaneBeams&) = default;
};

inline constexpr std::int32_t kMostUp = 200'000;           // 68.7 degrees
inline constexpr std::int32_t kMostAside = 1 << 19;        // half a turn
inline constexpr std::int32_t kLeastBetweenRows = 12;      // 0.004 degrees
inline constexpr std::uint32_t kMostColumnStep = 1 << 27;  // 11 degrees
inline constexpr std::int64_t kWholeTurn = std::int64_t{1} << 32;

// Whether they fit so many rows, and are within the limits.
bool beams_fit(const PlaneBeams& beams, std::size_t rows);

// The direction of each column: clockwise from `first`, it never falls, and ends within two turns. Empty: not known.
struct PlaneColumns {
  Angle first = 0;
  std::vector<std::int64_t> at;  // angle from `first`

  bool known() const { return !at.empty(); }
  // From column to column, on the average.
  std::int64_t step() const { return at.back() / static_cast<std::int64_t>(at.size() - 1); }
};

// The columns that lie within 0.03 degrees of these azimuths, 0.01 degree each, as they are sent;
// unknown if they do not turn clockwise, are fewer than two, or turn more than twice. out: takes their bytes, if any.
PlaneColumns put_columns(std::vector<std::uint8_t>& out, const std::vector<std::uint16_t>& azimuth);
void put_beams(std::vector<std::uint8_t>& out, const PlaneBeams& beams);

// These raise Section or Truncated.
PlaneColumns take_columns(ByteReader& reader, std::size_t columns);
PlaneBeams take_beams(ByteReader& reader, std::size_t rows);

}  // namespace lidarcodec
