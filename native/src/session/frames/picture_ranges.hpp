// Ranges of a frame of another sensor than an HDL-64E that are a picture (docs/wire-format-other-sensors.md,
// "Pictures"); lidarcodec/ranges/image/range_cells.py writes what stands beside it.
#pragma once
#include "session/frames/plane_section.hpp"

namespace lidarcodec {

// Codecs whose samples are the lower 16 bits of the numbers of ranges.
inline bool is_exact_picture(Codec codec) { return codec == Codec::Png || codec == Codec::Jxl; }

// Raises Section unless second ranges, and no other plane, have their name.
void check_second(const std::vector<NamedPlane>& planes);

// Puts the ranges in the picture of such a codec into the planes that came beside it, `columns` wide. Raises Section or
// Truncated.
void take_picture(const Message& message, const Outside& outside, std::size_t columns, PlaneSection& section);

}  // namespace lidarcodec
