// JPEGs of ranges (docs/wire-format.md, "jpeg"), checked before a decoder from outside gets them; in Python
// lidarcodec/codecs/jpeg_samples.py and lidarcodec/ranges/image/jpeg_file.py.
#pragma once
#include "session/outside.hpp"
#include "session/pictures/mapping.hpp"

namespace lidarcodec {

inline constexpr std::size_t kJpegBlock = 8;

inline std::size_t whole_blocks(std::size_t count) { return (count + kJpegBlock - 1) / kJpegBlock * kJpegBlock; }

// What samples mean, and what follows.
struct JpegSamples {
  unsigned bits = 0;
  std::vector<std::int32_t> range;  // of each sample
  Bytes rest;
};

// Raises Section.
JpegSamples split_samples(Bytes data, RangeScale scale);

// The samples of a JPEG. Raises Section for anything but one of these sides and bits.
std::vector<std::uint16_t> read_jpeg(const Outside& outside, const Picture& jpeg);

}  // namespace lidarcodec
