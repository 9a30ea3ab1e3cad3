// What the harnesses of ranges share: known columns, ways to compute, and ranges that go there and back.
#pragma once
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "fuzz_geometry.hpp"
#include "fuzz_input.hpp"
#include "predictive/coder.hpp"

using Bytes = std::vector<std::uint8_t>;
using Ranges = std::vector<std::uint16_t>;

// The first columns of an image, which both ends of a slab know; none of a whole frame.
inline Ranges columns_of(const Ranges& image, std::size_t width, lidarcodec::KnownColumns known) {
  Ranges before;
  for (std::size_t row = 0; row < lidarcodec::kMaskRows && known > 0; ++row)
    before.insert(before.end(), image.begin() + static_cast<std::ptrdiff_t>(row * width),
                  image.begin() + static_cast<std::ptrdiff_t>(row * width) + known);
  return before;
}

// One of the ways to code that this processor has, by any number. The plain one is for few: it takes ten times as long
// under the sanitizers, and no input decides its course.
inline lidarcodec::Path path_of(std::uint32_t number) {
  const std::vector<lidarcodec::Path> paths = lidarcodec::paths_here();
  return paths.size() == 1 || number % 16 == 0 ? paths.front() : paths[1 + number / 16 % (paths.size() - 1)];
}

// What is known of a frame at both ends.
struct GivenFrame {
  const Bytes& returns;
  const lidarcodec::MaskGeometry& geometry;
  lidarcodec::RangeCells cells;
  std::uint32_t turn;
  const std::uint16_t* expected;
  lidarcodec::KnownColumns known;
  bool halves = false;
};

// What one coder writes of a frame the other must read: within the bound, and of free ranges what was said to be sent.
inline void check_round_trip(const Ranges& image, const GivenFrame& given, bool quick, bool free,
                             lidarcodec::PredictiveCoder& encoder, lidarcodec::PredictiveCoder& decoder) {
  const std::size_t width = given.geometry.width;
  const Bytes& returns = given.returns;
  const Ranges before = columns_of(image, width, given.known);
  Ranges sent(image.size());
  const Bytes data =
      encoder.encode(image.data(), returns.data(), given.cells, given.geometry, given.turn, given.turn >> 9,
                     given.expected, given.known, nullptr, quick, free ? sent.data() : nullptr, given.halves);
  const Ranges came = decoder.decode(data.data(), data.size(), returns.data(), given.cells, given.geometry,
                                     given.expected, given.known, before.data());
  for (std::size_t i = 0; i < image.size(); ++i) {
    const int apart = returns[i] != 0 ? std::abs(int{came[i]} - int{image[i]}) : came[i];
    const bool is_known = static_cast<lidarcodec::KnownColumns>(i % width) < given.known;
    if (is_known ? came[i] != image[i]
                 : apart > static_cast<int>(given.cells.step / 2) || (returns[i] != 0 && came[i] == 0))
      std::abort();
    if (free && given.cells.step > 1 && !is_known && came[i] != sent[i]) std::abort();
  }
}

// Ranges that any numbers expect.
inline Ranges guesses_of(std::size_t count, unsigned shift) {
  Ranges guesses(count);
  for (std::size_t i = 0; i < count; ++i) guesses[i] = static_cast<std::uint16_t>(i * 40503u >> shift) * (i % 5 != 0);
  return guesses;
}
