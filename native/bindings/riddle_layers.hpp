// Layers of networks, as Python gives them.
#pragma once
#include "bindings.hpp"
#include "base/error.hpp"
#include "network/net.hpp"

// cases: (96, out) biases of rows and scales, or (0, out) where there are none.
inline lidarcodec::GivenLayer layer_of(const In<std::int16_t, 2>& weights, const In<std::int32_t, 1>& bias, std::uint32_t shift,
                                       const In<std::int8_t, 2>& cases) {
  const std::size_t out = weights.shape(0);
  if (bias.shape(0) != out || cases.shape(1) != out || (cases.shape(0) != 0 && cases.shape(0) != lidarcodec::kCases))
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a layer with other biases than sums");
  return {weights.shape(1), out, weights.data(), bias.data(), shift, cases.shape(0) == 0 ? nullptr : cases.data()};
}
