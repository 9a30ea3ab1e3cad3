// Networks with weights at random, for coders of ranges and alone.
#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "predictive/coder.hpp"

class RandomNumbers {
 public:
  explicit RandomNumbers(std::uint32_t seed) : seed_(seed) {}
  int up_to(int size) {  // either side of 0
    seed_ = seed_ * 1664525u + 1013904223u;
    return static_cast<int>(seed_ >> 8) % (2 * size + 1) - size;
  }

 private:
  std::uint32_t seed_;
};

// A network as given, with what its layers point to.
struct RandomLayers {
  std::array<std::vector<std::int16_t>, lidarcodec::kNetLayers> weights;
  std::array<std::vector<std::int32_t>, lidarcodec::kNetLayers> biases;
  std::array<lidarcodec::GivenLayer, lidarcodec::kNetLayers> layers;
  std::vector<std::int8_t> cases;

  // weight: the next one of layer l; most: of each layer's biases.
  template <class Weight>
  RandomLayers(RandomNumbers& random, const std::array<std::size_t, 4>& dims, const Weight& weight,
               const std::array<int, 3>& most, const std::array<std::uint32_t, 3>& shifts) {
    for (std::size_t l = 0; l < layers.size(); ++l) {
      for (std::size_t i = 0; i < dims[l] * dims[l + 1]; ++i)
        weights[l].push_back(static_cast<std::int16_t>(weight(l)));
      for (std::size_t i = 0; i < dims[l + 1]; ++i) biases[l].push_back(random.up_to(most[l]));
      layers[l] = {dims[l], dims[l + 1], weights[l].data(), biases[l].data(), shifts[l]};
    }
  }
  RandomLayers(const RandomLayers&) = delete;

  // Leaves about two in three tiles out.
  void leave_tiles_out(RandomNumbers& random) {
    using lidarcodec::kTileOutputs, lidarcodec::kTileInputs;
    for (std::size_t l = 0; l < layers.size(); ++l)
      for (std::size_t block = 0; block * kTileOutputs < layers[l].out; ++block)
        for (std::size_t in = 0; in < layers[l].in; in += kTileInputs) {
          if (random.up_to(1) == 0) continue;
          for (std::size_t o = block * kTileOutputs; o < end_of_outputs(layers[l], block); ++o)
            std::fill_n(weights[l].begin() + static_cast<std::ptrdiff_t>(o * layers[l].in + in), kTileInputs,
                        std::int16_t{0});
        }
  }

  // Biases of rows and scales in the first layer.
  void add_cases(RandomNumbers& random) {
    for (std::size_t i = 0; i < lidarcodec::kConditionalBiases * layers[0].out; ++i)
      cases.push_back(static_cast<std::int8_t>(random.up_to(127)));
    layers[0].conditional_bias = cases.data();
  }
};

// Networks whose results go to all ends. in_bytes: whether the first layer's weights fit 8 bits; the network for frames
// that expect something then has biases of cases, too.
inline std::shared_ptr<const lidarcodec::RiddleNets> random_nets(lidarcodec::NetForm form, bool in_bytes = false) {
  RandomNumbers random(7);
  auto nets = std::make_shared<lidarcodec::RiddleNets>();
  for (const std::size_t inputs : {lidarcodec::kInputsAlone, lidarcodec::kInputsExpecting}) {
    const auto weight = [&](std::size_t layer) { return random.up_to(in_bytes && layer == 0 ? 127 : 9000); };
    RandomLayers given(random, {inputs, 24, 16, lidarcodec::kNetOutputs}, weight,
                       {in_bytes ? 1000 : 100000, 100000, 100000}, {in_bytes ? 6u : 12u, 12u, 12u});
    if (in_bytes && inputs == lidarcodec::kInputsExpecting) given.add_cases(random);
    (inputs == lidarcodec::kInputsAlone ? nets->alone : nets->expecting).emplace(given.layers, form);
  }
  return nets;
}

// The same networks in the two forms that differ most, or none.
inline std::shared_ptr<const lidarcodec::RiddleNets> nets_of(bool learned, bool plain) {
  static const auto slow = random_nets(lidarcodec::NetForm::Plain),
                    quick = random_nets(lidarcodec::net_forms_here().back());
  return !learned ? nullptr : plain ? slow : quick;
}

// What networks of many sizes, with all tiles or with some, say of seven returns, by four, by two and by one: with
// weights of 8 bits, with those that two bytes with a sign can be, and with larger ones; small ones are as frequent as
// large ones, lest all sums be at their ends.
inline std::vector<std::int16_t> odds_of_networks(lidarcodec::NetForm form, bool with_cases, bool all_tiles) {
  RandomNumbers random(11);
  std::vector<std::int16_t> odds;
  for (const std::array<std::size_t, 2>& hidden :
       {std::array<std::size_t, 2>{8, 8}, {24, 40}, {96, 32}, {192, 48}, {256, 256}}) {
    for (const int most : {127, 127 * 256 + 127, 32767}) {
      const std::size_t inputs = random.up_to(1) > 0 ? lidarcodec::kInputsAlone : lidarcodec::kInputsExpecting;
      const auto weight = [&](std::size_t layer) {
        return random.up_to(layer == 2 ? most / 16 : most) >> (random.up_to(8) + 8);
      };
      RandomLayers given(
          random, {inputs, hidden[0], hidden[1], lidarcodec::kNetOutputs}, weight, {1000, 100000, 100000},
          most == 127 ? std::array<std::uint32_t, 3>{4, 4, 9} : std::array<std::uint32_t, 3>{12, 12, 13});
      for (auto& weights : given.weights)
        weights.front() = static_cast<std::int16_t>(most), weights.back() = static_cast<std::int16_t>(-most - 1);
      if (with_cases) given.add_cases(random);
      if (!all_tiles) given.leave_tiles_out(random);
      const lidarcodec::RiddleNet net(given.layers, form);
      std::array<lidarcodec::NetValues, 7> values;
      for (lidarcodec::NetValues& value : values)
        for (std::int8_t& in : value.in) in = static_cast<std::int8_t>(random.up_to(128));
      net.run(std::array{&values[0], &values[1], &values[2], &values[3]});
      net.run(std::array{&values[4], &values[5]});
      net.run(std::array{&values[6]});
      for (const lidarcodec::NetValues& value : values) {
        odds.insert(odds.end(), value.out.begin(), value.out.end());
        for (std::size_t leaf = 0; leaf < lidarcodec::kLeafOdds; ++leaf) odds.push_back(net.leaf_odds(value, leaf));
      }
    }
  }
  return odds;
}
