#include "ranges/holes.hpp"

#include <algorithm>
#include <cmath>

#include "base/error.hpp"
#include "ranges/dct.hpp"

namespace lidarcodec {

namespace {

// Over-relaxation of the projections, which halves the rounds, and the last threshold in quantiser steps. Fitted to
// KITTI drives.
constexpr float kRelaxation = 1.6f, kLastThreshold = 0.8f;

// Interpolates linearly between known samples, and extends the first and the last one. False: no sample is known.
bool fill_row(float* row, const std::uint8_t* known, std::size_t width) {
  std::size_t last = width;
  for (std::size_t at = 0; at < width; ++at) {
    if (!known[at]) continue;
    if (last == width) {
      std::fill(row, row + at, row[at]);
    } else if (at - last > 1) {
      const float gradient = (row[at] - row[last]) / static_cast<float>(at - last);
      for (std::size_t i = last + 1; i < at; ++i) row[i] = row[last] + gradient * static_cast<float>(i - last);
    }
    last = at;
  }
  if (last == width) return false;
  std::fill(row + last + 1, row + width, row[last]);
  return true;
}

struct Tile {
  float* samples;
  const std::uint8_t* known;
  std::size_t width;

  std::size_t count_known() const {
    std::size_t count = 0;
    for (std::size_t y = 0; y < kSide; ++y)
      for (std::size_t x = 0; x < kSide; ++x) count += known[y * width + x] != 0;
    return count;
  }
  void read(Block& out) const {
    for (std::size_t y = 0; y < kSide; ++y) std::copy_n(samples + y * width, kSide, out.data() + y * kSide);
  }
  void write_holes(const Block& in) const {
    for (std::size_t y = 0; y < kSide; ++y)
      for (std::size_t x = 0; x < kSide; ++x)
        if (!known[y * width + x]) samples[y * width + x] += kRelaxation * (in[y * kSide + x] - samples[y * width + x]);
  }
  void write_all(float value) const {
    for (std::size_t y = 0; y < kSide; ++y) std::fill_n(samples + y * width, kSide, value);
  }
};

// Projects the holes of a block onto few coefficients, with a threshold that falls from round to round.
void project(const Tile& tile, const StepTable& steps, unsigned rounds) {
  Block block;
  for (unsigned round = 0; round < rounds; ++round) {
    tile.read(block);
    Block c = forward_dct(block);
    const float factor = kLastThreshold + static_cast<float>(rounds - 1 - round) / static_cast<float>(rounds);
    for (std::size_t i = 1; i < c.size(); ++i)
      if (std::abs(c[i]) < factor * static_cast<float>(steps[i])) c[i] = 0;
    tile.write_holes(inverse_dct(c));
  }
}

}  // namespace

std::vector<float> fill_blocks(const float* samples, const std::uint8_t* known, std::size_t rows, std::size_t width,
                               const StepTable& steps, unsigned rounds) {
  if (rows % kSide || width % kSide) throw Error(ErrorCode::Settings, "an image that is not made of 8 x 8 blocks");
  std::vector<float> image(samples, samples + rows * width);
  for (std::size_t y = 0; y < rows; ++y) {
    float* row = image.data() + y * width;
    if (!fill_row(row, known + y * width, width) && y) std::copy_n(row - width, width, row);
  }
  for (std::size_t y = 0; y < rows; y += kSide) {
    float mean = 0;
    for (std::size_t x = 0; x < width; x += kSide) {
      const Tile tile{image.data() + y * width + x, known + y * width + x, width};
      const std::size_t count = tile.count_known();
      if (!count && x) {
        tile.write_all(mean);
        continue;
      }
      if (count && count < kSide * kSide) project(tile, steps, rounds);
      Block block;
      tile.read(block);
      mean = 0;
      for (float value : block) mean += value;
      mean /= static_cast<float>(block.size());
    }
  }
  return image;
}

void fill_predicted(std::uint16_t* values, const std::uint8_t* known, std::size_t rows, std::size_t width) {
  for (std::size_t y = 0; y < rows; ++y) {
    std::uint16_t* row = values + y * width;
    const std::uint16_t* above = y ? row - width : nullptr;
    for (std::size_t x = 0; x < width; ++x) {
      if (known[y * width + x]) continue;
      if (!x) {
        row[x] = above ? above[x] : std::uint16_t{0};
      } else if (!above) {
        row[x] = row[x - 1];
      } else {
        const int left = row[x - 1], up = above[x], corner = above[x - 1];
        row[x] = static_cast<std::uint16_t>(std::clamp(left + up - corner, std::min(left, up), std::max(left, up)));
      }
    }
  }
}

}  // namespace lidarcodec
