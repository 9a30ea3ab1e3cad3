// Images of ranges on each path of the processor. Writing and reading are compiled in files of their own, side by side:
// there are many forms, and each takes its time.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <type_traits>

#include "predictive/coder.hpp"
#include "predictive/rows.hpp"
#include "predictive/stage.hpp"

namespace lidarcodec {

inline constexpr std::int32_t kMaxLevel = 1000;
inline constexpr std::int32_t kMaxRange = 65535;

// What is known of each row where the last slab ends, in cells of so many range steps, free ones or not; 0: nothing.
struct SlabStates {
  std::array<RowEnd, kMaskRows> of;
  std::uint32_t step = 0;
  bool free = false;

  // Brings it to the cells of the slab that comes, whose differences begin with `start`; forgets it unless that goes on.
  void begin(const RangeCells& cells, std::uint32_t start, bool goes_on) {
    constexpr auto kMost = static_cast<std::int64_t>(kMaxDifference);
    const std::uint32_t to = cells.step;
    for (RowEnd& state : of) {
      if (step == 0 || !goes_on) {
        state = {RowState::at_start(start), {}};
      } else if (step != to || free != cells.free) {
        const auto scaled = [&](auto& x, std::int64_t most) {
          x = static_cast<std::remove_reference_t<decltype(x)>>(std::clamp(std::int64_t{x} * step / to, -most, most));
        };
        for (std::int32_t& range : state.last) {
          scaled(range, 16 * kMost);
          if (!cells.free) range = range / 16 * 16;
        }
        for (std::uint32_t* size : {&state.size1, &state.size2, &state.mean, &state.miss}) scaled(*size, kMost);
        scaled(state.level, kMost);
        scaled(state.bias, kMost);
      }
    }
    step = to;
    free = cells.free;
  }
};

// What an image is coded on, and with.
struct ImageCoding {
  Path path;
  PredictiveModel& model;
  Teaching teaching;
  SlabStates& states;
  bool slab;
  bool quick;  // with fewer contexts and leaves of its own; never with networks
};

// Write, or read, the returns of an image of (64, W) ranges: a whole frame or a slab.
void write_image(const ImageCoding& on, const RowSource& source, PredictiveParts<WideEncoder>& parts, const std::uint16_t* image);
void read_image(const ImageCoding& on, const RowSource& source, PredictiveParts<WideDecoder>& parts, std::uint16_t* image);

}  // namespace lidarcodec
