// What was last seen in each direction: ranges, and the azimuth at which they were measured. Frames may be cut
// anywhere.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/rows.hpp"

namespace lidarcodec {

inline constexpr std::size_t kSlots = 4096;  // directions of a turn: closer together than the firings of an HDL-64E
inline constexpr std::uint16_t kNoAzimuth = 0xFFFF;
inline constexpr std::uint32_t kLargestSweep = 4500;  // 45 degrees: an azimuth that advances further has jumped

using Halves = std::array<std::uint8_t, kRows>;  // block of each row: 0 upper, 1 lower

// Columns of a frame or slab; W of them.
struct Columns {
  std::size_t width = 0;
  const std::uint16_t* azimuth = nullptr;  // (2, W), 0 to 35999
  const std::uint8_t* fired = nullptr;     // (2, W)
};

// Raises Section if an azimuth is out of range.
void check_azimuths(const Columns& columns);

class RangeHistory {
 public:
  RangeHistory() { forget(); }

  void forget();

  // Stores the ranges of a frame, (64, W). Slots that the sensor passed without firing are emptied. Of two columns in
  // one slot the last one stays. Raises Section if an azimuth is out of range.
  void remember(const std::uint16_t* ranges, const Columns& columns, const Halves& half);

  // Azimuth at which each slot of a half was last measured; kNoAzimuth: never.
  const std::uint16_t* azimuths(std::size_t half) const { return azimuth_.data() + half * kSlots; }
  // Range of each slot; valid where the row's half has an azimuth.
  const std::uint16_t* ranges(std::size_t row) const { return ranges_.data() + row * kSlots; }

  static std::size_t slot_of(std::uint32_t azimuth) { return azimuth * kSlots / 36'000; }

 private:
  std::vector<std::uint16_t> ranges_ = std::vector<std::uint16_t>(kRows * kSlots);
  std::vector<std::uint16_t> azimuth_ = std::vector<std::uint16_t>(2 * kSlots);
  std::array<std::int32_t, 2> last_{};  // azimuth of each half's last column, -1: none
};

}  // namespace lidarcodec
