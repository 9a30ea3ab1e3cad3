// The arrays by which rows of a frame are known to the native coders: which halves fired, and of each row half and
// rotation.
#pragma once
#include "base/error.hpp"
#include "bindings.hpp"
#include "mask/coder.hpp"

// fired: (2, W); half, rotation: (64,). The geometry points into `fired`.
inline lidarcodec::MaskGeometry geometry_of(const In<std::uint8_t, 2>& fired, const In<std::uint8_t, 1>& half,
                                            const In<std::int32_t, 1>& rotation) {
  using lidarcodec::kMaskRows;
  if (fired.shape(0) != 2 || half.shape(0) != kMaskRows || rotation.shape(0) != kMaskRows) {
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "rows need fired (2, W), half (64,) and rotation (64,)");
  }
  lidarcodec::MaskGeometry geometry;
  geometry.width = fired.shape(1);
  geometry.fired = fired.data();
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    geometry.half[row] = half.data()[row] != 0;
    geometry.rotation[row] = rotation.data()[row];
  }
  return geometry;
}
