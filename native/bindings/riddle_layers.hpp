// Layers of networks, as Python gives them.
#pragma once
#include "base/error.hpp"
#include "bindings.hpp"
#include "network/net.hpp"

// conditional_bias: (96, out) biases of rows and scales, or (0, out) if there are none.
inline lidarcodec::GivenLayer layer_of(const In<std::int16_t, 2>& weights, const In<std::int32_t, 1>& bias,
                                       std::uint32_t shift, const In<std::int8_t, 2>& conditional_bias) {
  const std::size_t out = weights.shape(0);
  if (bias.shape(0) != out || conditional_bias.shape(1) != out ||
      (conditional_bias.shape(0) != 0 && conditional_bias.shape(0) != lidarcodec::kConditionalBiases))
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a layer with other biases than sums");
  return {weights.shape(1), out,   weights.data(),
          bias.data(),      shift, conditional_bias.shape(0) == 0 ? nullptr : conditional_bias.data()};
}
