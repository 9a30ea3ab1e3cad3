// The ranges of codec `pcodec`: differences in groups by activity, each group a chunk of pco (docs/wire-format.md,
// "pcodec").
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

// The indices of `returns` returns, 1 or more, in row order; out of a RANGE section behind its step. Raises Section or
// Truncated unless the bytes hold that many and nothing else.
std::vector<std::uint16_t> decode_pco_groups(const std::uint8_t* data, std::size_t size, std::size_t returns);

}  // namespace lidarcodec
