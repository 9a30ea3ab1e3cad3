// Networks for coders of ranges, with weights at random.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "predictive_coder.hpp"

// Networks with weights at random, whose results go to all ends. in_bytes: whether the first layer's weights fit 8 bits.
inline std::shared_ptr<const lidarcodec::RiddleNets> random_nets(lidarcodec::NetForm form, bool in_bytes = false) {
  std::uint32_t seed = 7;
  const auto random = [&](int size) {
    seed = seed * 1664525u + 1013904223u;
    return static_cast<int>(seed >> 8) % (2 * size + 1) - size;
  };
  auto nets = std::make_shared<lidarcodec::RiddleNets>();
  for (const std::size_t inputs : {lidarcodec::kInputsAlone, lidarcodec::kInputsExpecting}) {
    const std::array<std::size_t, 4> dims = {inputs, 24, 16, lidarcodec::kNetOutputs};
    std::array<std::vector<std::int16_t>, 3> weights;
    std::array<std::vector<std::int32_t>, 3> biases;
    std::array<lidarcodec::GivenLayer, 3> layers;
    for (std::size_t l = 0; l < layers.size(); ++l) {
      const bool bytes = in_bytes && l == 0;
      for (std::size_t i = 0; i < dims[l] * dims[l + 1]; ++i)
        weights[l].push_back(static_cast<std::int16_t>(random(bytes ? 127 : 9000)));
      for (std::size_t i = 0; i < dims[l + 1]; ++i) biases[l].push_back(random(bytes ? 1000 : 100000));
      layers[l] = {dims[l], dims[l + 1], weights[l].data(), biases[l].data(), bytes ? 6u : 12u};
    }
    (inputs == lidarcodec::kInputsAlone ? nets->alone : nets->expecting).emplace(layers, form);
  }
  return nets;
}

// The same networks in the two forms that differ most, or none.
inline std::shared_ptr<const lidarcodec::RiddleNets> nets_of(bool learned, bool plain) {
  static const auto slow = random_nets(lidarcodec::NetForm::Plain), quick = random_nets(lidarcodec::net_forms_here().back());
  return !learned ? nullptr : plain ? slow : quick;
}
