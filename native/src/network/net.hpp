// The networks of codec riddle. They predict the bits of a range difference from the surroundings of a return. The idea
// is RIDDLE's (Zhou et al., "RIDDLE: Lidar data compression with range image deep delta encoding", CVPR 2022); the
// layers, and the arithmetic in whole numbers, are ours.
//
// A multilayer perceptron: inputs of 8 bits, two hidden layers with a clipped ReLU (0 to 255), and 32 log odds
// (bits/cells.hpp), 16 for the nodes of the tree and one for the first offset bit of each leaf. A return needs only one
// of the latter; it is computed when the leaf is known. The first layer may have a bias for each row and for each
// scale, beside its ordinary one. Two of the inputs name row and scale. All sums fit 32 bits, which the constructor
// checks, so that sums in any order are equal.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace lidarcodec {

inline constexpr std::size_t kInputsAlone = 72, kInputsExpecting = 112;
inline constexpr std::size_t kMaxHidden = 256, kNetOutputs = 32, kNetLayers = 3;
inline constexpr std::size_t kTreeOdds = 16, kLeafOdds = kNetOutputs - kTreeOdds;
inline constexpr std::int32_t kHiddenMax = 255;
inline constexpr std::size_t kRowBiases = 64, kScaleBiases = 32, kConditionalBiases = kRowBiases + kScaleBiases;
inline constexpr std::size_t kRowInput = 52, kScaleInput = 47;  // the inputs that name row and scale

// The bias that an input names. For rows the input is 2 * row - 64; four steps of the input for scales share a bias.
inline std::size_t row_bias_of(std::int8_t in) {
  return static_cast<std::size_t>(std::clamp((in + 64) >> 1, 0, static_cast<int>(kRowBiases) - 1));
}
inline std::size_t scale_bias_of(std::int8_t in) {
  return static_cast<std::size_t>(std::clamp((in + 50) >> 2, 0, static_cast<int>(kScaleBiases) - 1));
}

// Ways to compute, with equal results. Plain: C++ alone. Vector: vectors of 128 bits, as every x86-64 (SSE2) and every
// 64-bit ARM (NEON) has them. Dot: the dot products of newer ARM. Avx2, Vnni: vectors of 256 and of 512 bits.
enum class NetForm { Plain, Vector, Dot, Avx2, Vnni };

// Those that this processor can run, the fastest last.
std::vector<NetForm> net_forms_here();

// "plain", "sse2" or "neon", "dotprod", "avx2", "avx512vnni".
const char* name_of(NetForm form);

// The form with this name; the fastest if the name is empty. Raises Settings if this processor cannot run it.
NetForm net_form_named(const std::string& name);

// The inputs of a return, its values in the second hidden layer, and the log odds of the tree's nodes. Not initialised,
// which would cost 3 % of the time of a return.
struct alignas(64) NetValues {
  std::array<std::int8_t, kInputsExpecting> in;
  alignas(64) std::array<std::int16_t, kMaxHidden> hidden;
  alignas(32) std::array<std::int16_t, kTreeOdds> out;
};

// A layer as a weight file has it: weights (out, in), a bias for each output, and the shift: weights are in steps of
// 2^-shift. Only the first layer may have biases of rows and scales, in steps of 1/64.
struct GivenLayer {
  std::size_t in = 0, out = 0;
  const std::int16_t* weights = nullptr;
  const std::int32_t* bias = nullptr;
  std::uint32_t shift = 0;
  const std::int8_t* conditional_bias = nullptr;  // (96, out): of rows, then of scales; or null
};

// The pruning mask of a layer has one bit for each tile of sixteen outputs and four inputs.
inline constexpr std::size_t kTileOutputs = 16, kTileInputs = 4;

inline std::size_t end_of_outputs(const GivenLayer& layer, std::size_t block) {
  return std::min(layer.out, (block + 1) * kTileOutputs);
}

// Whether a tile is pruned: all its weights, from input `in` on, are 0.
bool is_pruned(const GivenLayer& layer, std::size_t block, std::size_t in);

// An array aligned to the lines of the processor's cache.
template <class Number>
class Lines {
 public:
  void assign(std::size_t count) { lines_.assign((count * sizeof(Number) + sizeof(Line) - 1) / sizeof(Line), Line{}); }
  Number* data() { return reinterpret_cast<Number*>(lines_.data()); }
  const Number* data() const { return reinterpret_cast<const Number*>(lines_.data()); }

 private:
  struct alignas(64) Line {
    std::array<std::byte, 64> bytes;
  };
  std::vector<Line> lines_;
};

// The dot product of two arrays of so many times sixteen numbers.
struct PlainProducts {
  [[gnu::noinline]] static std::int32_t products(const std::int16_t* a, const std::int16_t* b, std::size_t blocks) {
    std::int32_t sum = 0;
    for (std::size_t i = 0; i < blocks * kTileOutputs; ++i) sum += a[i] * b[i];
    return sum;
  }
};

// Raises Section unless there are 72 or 112 inputs, 8 to 256 values in each hidden layer, in multiples of 8, and 32
// outputs; shifts are 3 to 13, of the last layer 9 to 13; and no sum can pass 32 bits.
void check_layers(const std::array<GivenLayer, kNetLayers>& layers);

class RiddleNet {
 public:
  // Raises Section as `check_layers` does.
  explicit RiddleNet(const std::array<GivenLayer, kNetLayers>& layers, NetForm form = net_forms_here().back());

  std::size_t inputs() const { return layers_[0].in; }

  // Hidden values and log odds of the tree, of one return or of several at once, which share the reads of the weights.
  void run(const std::array<NetValues*, 1>& values) const;
  void run(const std::array<NetValues*, 2>& values) const;
  void run(const std::array<NetValues*, 4>& values) const;

  // Log odds of the first offset bit of a leaf, 0 to 15, for a return whose hidden values are there.
  template <class Products = PlainProducts>
  std::int16_t leaf_odds(const NetValues& values, std::size_t leaf) const {
    const std::int16_t* const weights = leaves_.weights.data() + leaf * leaves_.blocks * kTileOutputs;
    const std::int32_t sum = leaves_.initial[leaf] + Products::products(weights, values.hidden.data(), leaves_.blocks);
    return static_cast<std::int16_t>(std::clamp(sum >> leaves_.shift, -32768, 32767));
  }

  struct Layer {
    std::size_t in = 0, out = 0;
    std::uint32_t shift = 0;  // of the sums, to the units of what comes out
    std::int32_t low = 0, high = 0;
    // The tiles that are not pruned, by their block of sixteen outputs. Weights of outputs beyond `out` are 0. For each
    // tile its first input; for each block, and after the last one, its first tile.
    std::vector<std::uint16_t> inputs_of;
    std::vector<std::size_t> tiles_of;
    // For each tile the weights of its first two inputs, a pair for each output, then those of the other two.
    Lines<std::int16_t> weights;
    // The same as bytes, four for each output: one plane if all weights fit 8 bits; otherwise a plane of upper bytes
    // and one of lower bytes, both signed; none if those do not fit.
    std::size_t planes = 0;
    Lines<std::int8_t> byte_weights;
    // Initial values of the sums: the biases, one set for each row if there are biases of rows, and what each scale
    // adds. They include the half that rounds a sum, and they cancel the 128 that some forms add to their inputs.
    // Modulo 2^32, as all sums are.
    Lines<std::int32_t> rows, scales;
    bool has_conditional_biases = false;
    std::size_t blocks() const { return (out + kTileOutputs - 1) / kTileOutputs; }
    std::size_t tiles() const { return inputs_of.size(); }
  };

 private:
  // The outputs of the last layer that are computed one by one: the weights of each are adjacent, followed by zeros.
  struct Leaves {
    std::size_t blocks = 0;
    std::uint32_t shift = 0;
    Lines<std::int16_t> weights;
    std::array<std::int32_t, kLeafOdds> initial{};
  };

  NetForm form_;
  std::array<Layer, kNetLayers> layers_;  // the last one has the outputs of the tree only
  Leaves leaves_;
};

}  // namespace lidarcodec
