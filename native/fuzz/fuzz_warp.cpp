// Any history, calibration and motion: whatever a message says, ranges are expected without harm, and a motion is found
// or not. The input's first bytes say how much there is; the rest are the numbers.
#include <vector>

#include "base/error.hpp"
#include "motion/registration.hpp"
#include "motion/warp.hpp"
#include "parts/fuzz_input.hpp"

using namespace lidarcodec;

namespace {

struct Frame {
  std::vector<std::uint16_t> azimuth, ranges;
  std::vector<std::uint8_t> fired;

  Frame(std::size_t width, std::uint32_t step, bool smooth, Numbers& numbers)
      : azimuth(2 * width), ranges(kRows * width), fired(2 * width) {
    std::uint32_t at = numbers.next(2);
    for (std::size_t c = 0; c < width; ++c, at += step) {
      azimuth[c] = static_cast<std::uint16_t>(at % (numbers.next(1) == 0 ? 36'001u : 36'000u));
      azimuth[width + c] = static_cast<std::uint16_t>((at + numbers.next(1) % 4 * 9) % 36'000);
    }
    for (std::uint8_t& f : fired) f = numbers.next(1) != 0;
    for (std::size_t i = 0; i < ranges.size(); ++i)
      ranges[i] =
          static_cast<std::uint16_t>(smooth ? 1000 + 40 * (64 - i / width) + numbers.next(1) % 8 : numbers.next(2));
  }

  Columns columns() const { return {azimuth.size() / 2, azimuth.data(), fired.data()}; }
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::uint8_t kind = input.byte();
  const std::size_t before = input.below(96), now = input.below(96);
  const std::uint32_t step = kind & 1u ? 18 : input.below(36'000);
  Numbers numbers(input.rest());

  BeamTable table;
  for (std::size_t row = 0; row < kRows; ++row) {
    table.half[row] = kind & 2u ? row % 2 : row >= 32;
    const bool wild = (kind & 4u) != 0;
    const auto number = [&](int sane) { return wild ? static_cast<std::int32_t>(numbers.next(4)) : sane; };
    table.rotation[row] = number(static_cast<int>(row % 6) * 4'000'000);
    table.vertical[row] = number(4'000'000 - static_cast<int>(row) * 700'000);
    table.distance[row] = number(9'000'000);
    table.vertical_offset[row] = number(2'000'000);
    table.horizontal_offset[row] = number(row % 2 ? 260'000 : -260'000);
  }
  Motion motion;
  if (kind & 8u) {
    for (std::int32_t& r : motion.rotation) r = static_cast<std::int32_t>(numbers.next(4));
    for (std::int32_t& t : motion.translation) t = static_cast<std::int32_t>(numbers.next(4));
  } else {
    motion.translation[0] = static_cast<std::int32_t>(numbers.next(2)) - 32'768;
  }

  const Frame first(before, step, kind & 16u, numbers), second(now, step, kind & 16u, numbers);
  RangeHistory history;
  try {
    history.remember(first.ranges.data(), first.columns(), table.half);
    const std::vector<std::uint16_t> ranges = expected_ranges(history, table, motion, second.columns());
    if (ranges.size() != kRows * now) __builtin_trap();
    if (kind & 32u) find_motion(history, second.ranges.data(), second.columns(), table, motion, (kind & 64u) != 0);
  } catch (const Error&) {
  }
  return 0;
}
