// Whether it pays to move the frame before, for encoders.
#pragma once
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <vector>

#include "images/memory.hpp"
#include "plane_motion/finder.hpp"
#include "plane_motion/moved.hpp"

namespace lidarcodec {

// The ranges of the frame before, in eighths, where its columns look, and where those of this frame look in it.
struct Seen {
  const std::vector<std::int32_t>& eighths;
  const PlaneColumns& columns;
  const std::vector<ColumnRun>& runs;
};

inline std::optional<PlaneMotion> motion_between(const PlaneBeams& beams, const Seen& before, const PlaneImage& ranges,
                                                 const PlaneColumns& now, double metre,
                                                 const std::optional<PlaneMotion>& start) {
  std::vector<std::int32_t> eighths(ranges.size());
  for (std::size_t i = 0; i < ranges.size(); ++i) eighths[i] = static_cast<std::int32_t>(8 * ranges[i]);
  const RangeView old{before.eighths, before.columns}, fresh{eighths, now};
  std::optional<PlaneMotion> found = find_motion(beams, old, fresh, metre, start);
  if (!found && start) found = find_motion(beams, old, fresh, metre, std::nullopt);
  return found;
}

// More than a centimetre, or 0.3 mrad.
inline bool is_moved(const PlaneMotion& motion, double metre) {
  constexpr std::int32_t turn = 40;
  const auto shift = static_cast<std::int32_t>(metre / 100);
  const auto beyond = [](const std::array<std::int32_t, 3>& parts, std::int32_t most) {
    return std::any_of(parts.begin(), parts.end(), [&](std::int32_t part) { return std::abs(part) > most; });
  };
  return beyond(motion.turn, turn) || beyond(motion.shift, shift);
}

// Whether moved ranges are nearer to those of this frame than the frame before is as it was. Looks at every third cell.
inline bool pays(const Seen& before, const MovedPlane& moved, const PlaneImage& ranges) {
  const std::size_t old_columns = before.columns.at.size();
  std::vector<std::size_t> place;
  for (const ColumnRun& run : before.runs)
    for (std::size_t i = 0; i < run.count; ++i) place.push_back((run.first + i) % old_columns);
  const std::size_t columns = place.size();
  std::int64_t still = 0, along = 0, cells = 0;
  for (std::size_t i = 0; i < ranges.size(); i += 3) {
    if (ranges[i] == 0) continue;
    const auto here = static_cast<std::int32_t>(8 * ranges[i]);
    const std::int32_t was = before.eighths[i / columns * old_columns + place[i % columns]];
    const auto cost = [&](std::int32_t off) { return quarter_log(static_cast<std::uint32_t>(std::abs(off) / 8)); };
    const std::uint32_t as_it_was = cost(here - was);
    still += as_it_was;
    along += moved.source[i] >= 0 ? cost(here - moved.mean[i]) : as_it_was;
    ++cells;
  }
  return 4 * (still - along) > cells;  // a sixteenth of a bit a return
}

}  // namespace lidarcodec
