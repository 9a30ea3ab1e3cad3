// Range images and their cells, as Python gives them.
#pragma once
#include "base/error.hpp"
#include "bindings.hpp"
#include "geometry.hpp"
#include "predictive/coder.hpp"

template <class T>
void expect_image(const In<T, 2>& image, const lidarcodec::MaskGeometry& geometry) {
  if (image.shape(0) != lidarcodec::kMaskRows || image.shape(1) != geometry.width)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "ranges and returns are (64, W), as wide as the columns");
}

// (64, W), or (64, 0) where nothing is expected.
inline const std::uint16_t* expectation(const In<std::uint16_t, 2>& expected,
                                        const lidarcodec::MaskGeometry& geometry) {
  if (expected.shape(0) == lidarcodec::kMaskRows && expected.shape(1) == 0) return nullptr;
  expect_image(expected, geometry);
  return expected.data();
}

inline lidarcodec::RangeCells cells_of(std::uint32_t step, const In<std::int32_t, 1>& level) {
  if (level.shape(0) != lidarcodec::kMaskRows)
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "levels are (64,)");
  lidarcodec::RangeCells cells;
  cells.step = step;
  for (std::size_t row = 0; row < lidarcodec::kMaskRows; ++row) cells.level[row] = level.data()[row];
  return cells;
}
