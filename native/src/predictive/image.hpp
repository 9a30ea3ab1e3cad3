// Images of ranges on each path of the processor. write.cpp and read.cpp instantiate all forms, and are compiled in
// parallel.
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

// The state of each row at the end of the last slab. Its ranges are in cells of `step` range steps; step 0: there was
// no slab.
struct SlabEnds {
  std::array<RowEnd, kMaskRows> of;
  std::uint32_t step = 0;
  bool free = false;

  // Converts the states to the cells of the next slab. start: the first difference. goes_on: whether the slab continues
  // the last one; otherwise the states are reset.
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

// How an image is coded.
struct ImageCoding {
  Path path;
  PredictiveModel& model;
  NetworkUse network;
  SlabEnds& states;
  bool slab;
  bool quick;  // fewer contexts, and leaves of its own; never with a network
};

// Encode or decode the returns of an image of ranges, (64, W): rows of a whole frame, or a slab.
void write_image(const ImageCoding& on, const RowSource& source, PredictiveParts<WideEncoder>& parts,
                 const std::uint16_t* image);
void read_image(const ImageCoding& on, const RowSource& source, PredictiveParts<WideDecoder>& parts,
                std::uint16_t* image);

}  // namespace lidarcodec
