#include "motion/range_history.hpp"

#include <algorithm>
#include <string>

#include "base/error.hpp"
#include "motion/fixed_angle.hpp"

namespace lidarcodec {

void check_azimuths(const Columns& columns) {
  const std::uint16_t* end = columns.azimuth + 2 * columns.width;
  const std::uint16_t* beyond =
      std::find_if(columns.azimuth, end, [](std::uint16_t a) { return a >= kAzimuthStepsPerTurn; });
  if (beyond != end)
    throw Error(ErrorCode::Section,
                "an azimuth of " + std::to_string(*beyond) + " is beyond a turn: 35999 is the largest");
}

void RangeHistory::forget() {
  std::fill(azimuth_.begin(), azimuth_.end(), kNoAzimuth);
  last_ = {-1, -1};
}

void RangeHistory::remember(const std::uint16_t* ranges, const Columns& columns, const Halves& half) {
  check_azimuths(columns);
  std::array<std::vector<std::uint16_t>, 2> slot;  // of each fired column
  std::array<std::vector<std::uint32_t>, 2> column;
  for (std::size_t h = 0; h < 2; ++h) {
    std::uint16_t* marks = azimuth_.data() + h * kSlots;
    for (std::size_t c = 0; c < columns.width; ++c) {
      if (!columns.fired[h * columns.width + c]) continue;
      const std::uint32_t azimuth = columns.azimuth[h * columns.width + c];
      const std::size_t at = slot_of(azimuth);
      const std::uint32_t swept =
          last_[h] < 0 ? 0
                       : (azimuth + kAzimuthStepsPerTurn - static_cast<std::uint32_t>(last_[h])) % kAzimuthStepsPerTurn;
      if (swept <= kLargestSweep) {
        const std::size_t from = slot_of((azimuth + kAzimuthStepsPerTurn - swept) % kAzimuthStepsPerTurn);
        for (std::size_t s = from; s != at; s = (s + 1) % kSlots)
          if (s != from) marks[s] = kNoAzimuth;
      }
      marks[at] = static_cast<std::uint16_t>(azimuth);
      last_[h] = static_cast<std::int32_t>(azimuth);
      slot[h].push_back(static_cast<std::uint16_t>(at));
      column[h].push_back(static_cast<std::uint32_t>(c));
    }
  }
  for (std::size_t row = 0; row < kRows; ++row) {
    const std::size_t h = half[row] != 0;
    const std::uint16_t* from = ranges + row * columns.width;
    std::uint16_t* to = ranges_.data() + row * kSlots;
    for (std::size_t k = 0; k < slot[h].size(); ++k) to[slot[h][k]] = from[column[h][k]];
  }
}

}  // namespace lidarcodec
