// Ranges of the samples of pictures that do not keep a bound (docs/wire-format.md, "jpeg"), in Python
// lidarcodec/ranges/mapping.py.
#pragma once
#include <cstdint>
#include <vector>

#include "session/outside.hpp"

namespace lidarcodec {

enum class Mapping : std::uint8_t { Linear, Root, Log, Paper };

// A scale of ranges: the largest one, in steps, and the step in micrometres.
struct RangeScale {
  std::uint32_t most = 0, step_um = 0;

  // range_step: in 1e-7 m
  static RangeScale of(std::uint32_t most, std::uint32_t range_step);
};

inline constexpr RangeScale kCanvasScale{66'535, 2'000};  // of an HDL-64E: 65535, and 1000 that a row's level adds

// (2^bits,) range of each sample, 0 to `top`. top: 1 to 2^20; step_um: a range step, in micrometres, at least 1
std::vector<std::int32_t> ranges_of_samples(Mapping mapping, unsigned bits, std::uint32_t top, std::uint32_t step_um);

// The samples of a picture, each a place in such a list. Raises Section.
std::vector<std::uint16_t> mapped_samples(const Outside& outside, const Picture& picture);

}  // namespace lidarcodec
