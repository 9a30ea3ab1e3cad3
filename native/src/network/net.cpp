#include "network/net.hpp"

#include <algorithm>
#include <cstdlib>
#include <limits>

#include "base/error.hpp"
#include "base/processor.hpp"
#include "network/net_lanes.hpp"
#include "network/net_plain.hpp"

#if defined(__x86_64__)
#include "network/net_avx2.hpp"
#include "network/net_vnni.hpp"
#elif defined(__aarch64__) && defined(__linux__)
#include <asm/hwcap.h>
#include <sys/auxv.h>

#include "network/net_dot.hpp"
#define LIDARCODEC_NET_DOT
#endif

namespace lidarcodec {
namespace {

using namespace net_forms;

// The shifts that weights may have, and what is added for sums: inputs have steps of 1/32, hidden values of 1/8, and
// log odds of 1/4096, so 32 / 8 = 2^2, 8 / 8 = 2^0 and 8 / 4096 = 2^-9.
struct Shifts {
  std::uint32_t least, most;
  std::int32_t of_sums;
};
constexpr std::array<Shifts, kNetLayers> kShifts = {{{3, 13, 2}, {3, 13, 0}, {9, 13, -9}}};
constexpr std::int64_t kMostRounding = 1 << 14;  // what half_of gives for the largest shift of sums, 15

// Runs the layers one after the other, with values of 16 bits.
template <std::size_t N, class Run>
void run_in_words(const std::array<Layer, kNetLayers>& layers, const std::array<NetValues*, N>& values,
                  const Run& run) {
  std::array<std::array<Words, kNetLayers - 1>, N> words;  // the inputs of each layer but the last
  std::array<const std::int16_t*, N> in;
  std::array<std::int16_t*, N> out;
  for (std::size_t r = 0; r < N; ++r) std::copy_n(values[r]->in.data(), layers[0].in, words[r][0].of.data());
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    for (std::size_t r = 0; r < N; ++r) {
      NetValues& of = *values[r];
      in[r] = l + 1 == kNetLayers ? of.hidden.data() : words[r][l].of.data();
      out[r] = l + 1 == kNetLayers ? of.out.data() : l + 2 == kNetLayers ? of.hidden.data() : words[r][l + 1].of.data();
    }
    run(layers[l], initial_of(layers[l], values), in, out);
  }
}

// Splits four returns into two times two if the registers hold only two.
template <std::size_t kGroup, std::size_t N, class Run>
void in_groups(const std::array<InitialSums, N>& initial, const std::array<const std::int16_t*, N>& in,
               const std::array<std::int16_t*, N>& out, const Run& run) {
  if constexpr (N <= kGroup) {
    run(initial, in, out);
  } else {
    run(std::array{initial[0], initial[1]}, std::array{in[0], in[1]}, std::array{out[0], out[1]});
    run(std::array{initial[2], initial[3]}, std::array{in[2], in[3]}, std::array{out[2], out[3]});
  }
}

template <std::size_t N>
void run_layers(NetForm form, const std::array<Layer, kNetLayers>& layers, const std::array<NetValues*, N>& values) {
  switch (form) {
#if defined(__x86_64__)
    case NetForm::Vnni:
      return run_vnni(layers, values);
    case NetForm::Avx2:
      return run_in_words(layers, values, [](const Layer& layer, const auto& initial, const auto& in, const auto& out) {
        layer_avx2(layer, initial, in, out);
      });
#endif
#if defined(LIDARCODEC_NET_DOT)
    case NetForm::Dot:
      return run_dot(layers, values);
#endif
#if defined(__wasm__)
    default:  // no plain form, which a page would load for nothing
#endif
#if defined(LIDARCODEC_NET_LANES)
    case NetForm::Vector:
      return run_in_words(layers, values, [](const Layer& layer, const auto& initial, const auto& in, const auto& out) {
        in_groups<Lanes::kReturns>(initial, in, out, [&](const auto&... some) { layer_in_lanes(layer, some...); });
      });
#endif
#if !defined(__wasm__)
    default:
      return run_in_words(layers, values, [](const Layer& layer, const auto& initial, const auto& in, const auto& out) {
        for (std::size_t r = 0; r < N; ++r) layer_plainly(layer, initial[r], in[r], out[r]);
      });
#endif
  }
}

// What is added to the inputs of each layer so that they fit bytes: unsigned ones for VNNI, signed ones for dot
// products on ARM. And whether weights may be two bytes.
#if defined(__aarch64__)
constexpr std::array<std::int32_t, kNetLayers> kInputOffset = {0, -128, -128};
constexpr bool kTwoPlanes = true;
#else
constexpr std::array<std::int32_t, kNetLayers> kInputOffset = {128, 0, 0};
constexpr bool kTwoPlanes = false;
#endif

// A layer without the outputs that are computed one by one.
GivenLayer without_leaves(GivenLayer layer, std::size_t number) {
  if (number + 1 == kNetLayers) layer.out = kTreeOdds;
  return layer;
}

// Calls `put` with each weight of the tiles: tile, output, input within the tile, weight.
template <class Put>
void for_each_weight(const GivenLayer& from, const Layer& layer, const Put& put) {
  for (std::size_t block = 0; block < layer.blocks(); ++block)
    for (std::size_t tile = layer.tiles_of[block]; tile < layer.tiles_of[block + 1]; ++tile)
      for (std::size_t o = block * kTileOutputs; o < end_of_outputs(from, block); ++o)
        for (std::size_t i = 0; i < kTileInputs; ++i)
          put(tile, o % kTileOutputs, i, from.weights[o * from.in + layer.inputs_of[tile] + i]);
}

// Sets the tiles that are not pruned, and their weights.
void set_tiles(const GivenLayer& from, Layer& layer) {
  layer.tiles_of.push_back(0);
  for (std::size_t block = 0; block < layer.blocks(); ++block) {
    for (std::size_t in = 0; in < from.in; in += kTileInputs)
      if (!is_pruned(from, block, in)) layer.inputs_of.push_back(static_cast<std::uint16_t>(in));
    layer.tiles_of.push_back(layer.tiles());
  }
  layer.weights.assign(layer.tiles() * kTileWeights);
  for_each_weight(from, layer, [&](std::size_t tile, std::size_t sum, std::size_t i, std::int16_t weight) {
    layer.weights.data()[tile * kTileWeights + (i / 2 * kTileOutputs + sum) * 2 + i % 2] = weight;
  });
}

// Sets the weights as bytes, if they fit.
void set_bytes(const GivenLayer& from, Layer& layer) {
  const auto fit = [&](int least, int most) {
    return std::all_of(from.weights, from.weights + from.in * from.out,
                       [&](std::int16_t w) { return w >= least && w <= most; });
  };
  layer.planes = fit(-128, 127) ? 1 : kTwoPlanes && fit(-32768, 127 * 256 + 127) ? 2 : 0;
  const std::size_t size = layer.tiles() * kTileWeights;  // of a plane
  layer.byte_weights.assign(layer.planes * size);
  if (layer.planes == 0) return;
  for_each_weight(from, layer, [&](std::size_t tile, std::size_t sum, std::size_t i, std::int16_t weight) {
    std::int8_t* const to = layer.byte_weights.data() + tile * kTileWeights + sum * kTileInputs + i;
    const auto low = static_cast<std::int8_t>(weight);
    if (layer.planes == 2) *to = static_cast<std::int8_t>((weight - low) / 256);
    to[(layer.planes - 1) * size] = low;
  });
}

// What is added to a sum before the shift, so that it rounds to nearest.
constexpr std::int32_t half_of(std::uint32_t shift) { return shift == 0 ? 0 : 1 << (shift - 1); }

// Sets the initial values of sums, for inputs to which `offset` was added.
void set_initial_sums(const GivenLayer& from, std::int32_t offset, Layer& layer) {
  const std::size_t width = layer.blocks() * kTileOutputs;
  const auto half = static_cast<std::uint32_t>(half_of(layer.shift));
  layer.has_conditional_biases = from.conditional_bias != nullptr;
  layer.rows.assign((layer.has_conditional_biases ? kRowBiases : 1) * width);
  layer.scales.assign((layer.has_conditional_biases ? kScaleBiases : 1) * width);
  for (std::size_t o = 0; o < from.out; ++o) {
    std::uint32_t bias = static_cast<std::uint32_t>(from.bias[o]) + half;
    for (std::size_t i = 0; i < from.in; ++i)
      bias -= static_cast<std::uint32_t>(offset * from.weights[o * from.in + i]);
    layer.rows.data()[o] = static_cast<std::int32_t>(bias);
    if (!layer.has_conditional_biases) continue;
    const auto conditional = [&](std::size_t number) {
      return from.conditional_bias[number * from.out + o] * (1 << (from.shift - 1));
    };
    for (std::size_t row = 0; row < kRowBiases; ++row)
      layer.rows.data()[row * width + o] =
          static_cast<std::int32_t>(bias + static_cast<std::uint32_t>(conditional(row)));
    for (std::size_t scale = 0; scale < kScaleBiases; ++scale)
      layer.scales.data()[scale * width + o] = conditional(kRowBiases + scale);
  }
}

// Checks a layer. largest: the largest absolute value of its inputs.
void check(const GivenLayer& given, std::size_t number, std::int64_t largest) {
  if (given.shift < kShifts[number].least || given.shift > kShifts[number].most)
    throw Error(ErrorCode::Section, "the shift of a layer is out of range");
  if (given.conditional_bias != nullptr && number != 0)
    throw Error(ErrorCode::Section, "only the first layer of a network may have biases of rows and scales");
  const std::int64_t of_conditional = given.conditional_bias == nullptr ? 0 : 256 << (given.shift - 1);
  for (std::size_t o = 0; o < given.out; ++o) {
    std::int64_t sum = std::abs(static_cast<std::int64_t>(given.bias[o])) + of_conditional + kMostRounding;
    for (std::size_t i = 0; i < given.in; ++i)
      sum += largest * std::abs(static_cast<std::int64_t>(given.weights[o * given.in + i]));
    if (sum > std::numeric_limits<std::int32_t>::max())
      throw Error(ErrorCode::Section, "sums of a network can pass 32 bits");
  }
}

}  // namespace

bool is_pruned(const GivenLayer& layer, std::size_t block, std::size_t in) {
  for (std::size_t o = block * kTileOutputs; o < end_of_outputs(layer, block); ++o)
    for (std::size_t i = in; i < in + kTileInputs; ++i)
      if (layer.weights[o * layer.in + i] != 0) return false;
  return true;
}

std::vector<NetForm> net_forms_here() {
  std::vector<NetForm> forms = {NetForm::Plain};
#if defined(LIDARCODEC_NET_LANES)
  forms.push_back(NetForm::Vector);
#endif
#if defined(LIDARCODEC_NET_DOT)
  if ((getauxval(AT_HWCAP) & HWCAP_ASIMDDP) != 0) forms.push_back(NetForm::Dot);
#endif
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx2")) forms.push_back(NetForm::Avx2);
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512vnni"))
    forms.push_back(NetForm::Vnni);
#endif
  return forms;
}

const char* name_of(NetForm form) {
  switch (form) {
    case NetForm::Plain:
      return "plain";
    case NetForm::Vector:
      return name_of(Path::Vector);
    case NetForm::Dot:
      return "dotprod";
    case NetForm::Avx2:
      return "avx2";
    case NetForm::Vnni:
      return "avx512vnni";
  }
  return "";
}

NetForm net_form_named(const std::string& name) {
  const std::vector<NetForm> here = net_forms_here();
  if (name.empty()) return here.back();
  for (const NetForm form : here)
    if (name == name_of(form)) return form;
  throw Error(ErrorCode::Settings, "this processor cannot run networks in such a form");
}

void check_layers(const std::array<GivenLayer, kNetLayers>& given) {
  const auto hidden = [](std::size_t n) { return n >= 8 && n <= kMaxHidden && n % 8 == 0; };
  if ((given[0].in != kInputsAlone && given[0].in != kInputsExpecting) || !hidden(given[0].out) ||
      given[1].in != given[0].out || !hidden(given[1].out) || given[2].in != given[1].out ||
      given[2].out != kNetOutputs)
    throw Error(ErrorCode::Section, "the layers of a network do not fit each other");
  for (std::size_t l = 0; l < kNetLayers; ++l) check(given[l], l, l == 0 ? 128 : kHiddenMax);
}

RiddleNet::RiddleNet(const std::array<GivenLayer, kNetLayers>& given, NetForm form) : form_(form) {
  check_layers(given);
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    const GivenLayer from = without_leaves(given[l], l);
    Layer& layer = layers_[l];
    layer.in = from.in;
    layer.out = from.out;
    layer.shift = static_cast<std::uint32_t>(static_cast<std::int32_t>(from.shift) + kShifts[l].of_sums);
    layer.low = l == 2 ? -32768 : 0;
    layer.high = l == 2 ? 32767 : kHiddenMax;
    set_tiles(from, layer);
    set_bytes(from, layer);
    if (form_ == NetForm::Dot && layer.planes == 0) form_ = NetForm::Vector;
  }
  const bool in_bytes = form_ == NetForm::Vnni || form_ == NetForm::Dot;
  for (std::size_t l = 0; l < kNetLayers; ++l)
    set_initial_sums(without_leaves(given[l], l), in_bytes ? kInputOffset[l] : 0, layers_[l]);

  const GivenLayer& last = given.back();
  leaves_.blocks = layers_[1].blocks();
  leaves_.shift = layers_.back().shift;
  leaves_.weights.assign(kLeafOdds * leaves_.blocks * kTileOutputs);
  for (std::size_t leaf = 0; leaf < kLeafOdds; ++leaf) {
    std::copy_n(last.weights + (kTreeOdds + leaf) * last.in, last.in,
                leaves_.weights.data() + leaf * leaves_.blocks * kTileOutputs);
    leaves_.initial[leaf] = last.bias[kTreeOdds + leaf] + half_of(leaves_.shift);
  }
}

void RiddleNet::run(const std::array<NetValues*, 1>& values) const { run_layers(form_, layers_, values); }

void RiddleNet::run(const std::array<NetValues*, 2>& values) const { run_layers(form_, layers_, values); }

void RiddleNet::run(const std::array<NetValues*, 4>& values) const { run_layers(form_, layers_, values); }

}  // namespace lidarcodec
