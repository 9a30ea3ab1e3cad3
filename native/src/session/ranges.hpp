// RANGE sections of the codecs that quantise (docs/wire-format.md, "Range steps"): zstd, pcodec, png.
#pragma once
#include <cstdint>
#include <utility>
#include <vector>

#include "session/message.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

// The step of a RANGE section, and what follows it. Raises Section.
std::pair<std::uint32_t, Bytes> split_step(Bytes section);

// The range of an index, never 0. Raises Section.
std::uint16_t range_of_index(std::uint32_t index, std::uint32_t step);

// (64, W), 0 outside of `returns`. Raises Section or Truncated.
std::vector<std::uint16_t> decode_quantised(const Message& message, const Outside& outside,
                                            const std::vector<std::uint8_t>& returns);

}  // namespace lidarcodec
