// Layers of networks, as Python gives them.
#pragma once
#include "bindings.hpp"
#include "error.hpp"
#include "riddle_net.hpp"

inline lidarcodec::GivenLayer layer_of(const In<std::int16_t, 2>& weights, const In<std::int32_t, 1>& bias, std::uint32_t shift) {
  if (bias.shape(0) != weights.shape(0))
    throw lidarcodec::Error(lidarcodec::ErrorCode::Section, "a layer with other biases than sums");
  return {weights.shape(1), weights.shape(0), weights.data(), bias.data(), shift};
}
