// Weight files of codec `riddle` (docs/wire-format-riddle-weights.md), in Python lidarcodec/network/weight_file.py.
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "base/bytes.hpp"
#include "network/net.hpp"

namespace lidarcodec {

inline constexpr std::size_t kMostWeightBytes = 4u << 20;
inline constexpr std::size_t kMostNetworks = 6;

// Weights (out, in) of 16 bits, biases of outputs, and those of rows and scales, (96, out) or none.
struct NetworkLayer {
  std::size_t in = 0, out = 0;
  std::uint32_t shift = 0;
  std::vector<std::int16_t> weights;
  std::vector<std::int32_t> bias;
  std::vector<std::int8_t> conditional_bias;

  GivenLayer given() const {
    return {in, out, weights.data(), bias.data(), shift, conditional_bias.empty() ? nullptr : conditional_bias.data()};
  }
  bool in_bytes() const;          // whether all weights fit 8 bits
  bool has_pruned_tiles() const;  // whether all weights of a tile are 0
};

struct Network {
  bool expects = false;
  std::uint8_t size = 0;  // 0 small, 1 large, 2 largest
  std::array<NetworkLayer, kNetLayers> layers;

  std::array<GivenLayer, kNetLayers> given() const { return {layers[0].given(), layers[1].given(), layers[2].given()}; }
};

struct WeightFile {
  std::string name;  // 16 hex digits
  std::vector<Network> networks;

  // That of this kind and size, or of the nearest size; of two the smaller. Raises Section if there is none of the
  // kind.
  const Network& network(bool expects, std::uint8_t size) const;
};

// The networks of a file's bytes, from anybody: nothing is used before it is checked. The provenance is not looked
// into. Raises Header, Version, Truncated, Checksum or Section.
WeightFile read_weights(Bytes data);

// The bytes of a file of these networks, without a provenance.
std::vector<std::uint8_t> write_weights(const std::vector<Network>& networks);

}  // namespace lidarcodec
