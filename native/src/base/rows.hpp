// The number of rows of a frame: the lasers of an HDL-64E.
#pragma once
#include <cstddef>

namespace lidarcodec {

inline constexpr std::size_t kRows = 64;

}  // namespace lidarcodec
