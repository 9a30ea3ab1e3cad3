// The networks of codec riddle: what a return's surroundings say of its difference, in whole numbers.
//
// Three layers: inputs of 8 bits, two hidden layers of 0..255, and 32 log odds (bits/cells.hpp): those of the tree's nodes, then of
// each leaf that of the first offset bit. A return needs one of the latter; it is computed once the leaf is known. Sums of the
// first layer may begin with biases of the return's row and of its scale, which two of its inputs tell. All sums fit 32 bits,
// which is checked when a network is made, so that any order of adding gives the same.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace lidarcodec {

inline constexpr std::size_t kInputsAlone = 72, kInputsExpecting = 112;
inline constexpr std::size_t kMostHidden = 256, kNetOutputs = 32, kNetLayers = 3;
inline constexpr std::size_t kTreeOdds = 16, kLeafOdds = kNetOutputs - kTreeOdds;
inline constexpr std::int32_t kMiddleTop = 255;
inline constexpr std::size_t kRowCases = 64, kScaleCases = 32, kCases = kRowCases + kScaleCases;
inline constexpr std::size_t kRowInput = 52, kScaleInput = 47;  // which tell them

inline std::size_t row_case(std::int8_t in) { return static_cast<std::size_t>(std::clamp((in + 64) >> 1, 0, static_cast<int>(kRowCases) - 1)); }
inline std::size_t scale_case(std::int8_t in) { return static_cast<std::size_t>(std::clamp((in + 50) >> 2, 0, static_cast<int>(kScaleCases) - 1)); }

// Ways to compute, all with the same results. Plain: C++ alone. Vector: vectors of 128 bits, as every x86-64 (SSE2) and every
// 64-bit ARM (NEON) has them. Dot: the dot products of newer ARM. Avx2, Vnni: vectors of 256 and of 512 bits.
enum class NetForm { Plain, Vector, Dot, Avx2, Vnni };

// Those that this processor can run, the quickest last.
std::vector<NetForm> net_forms_here();

// "plain", "sse2" or "neon", "dotprod", "avx2", "avx512vnni".
const char* name_of(NetForm form);

// The form of a name; of an empty one the quickest. Raises Settings if this processor cannot run it.
NetForm net_form_named(const std::string& name);

// Inputs, as many as the network has, and what comes of them: log odds of the tree's nodes, and what the last layer takes. Not
// set to 0 before: that took 3 % of the time of a return.
struct alignas(64) NetValues {
  std::array<std::int8_t, kInputsExpecting> in;
  alignas(64) std::array<std::int16_t, kMostHidden> hidden;
  alignas(32) std::array<std::int16_t, kTreeOdds> out;
};

// A layer as given: weights (out, in), a bias for each sum, and the shift of the weights. Only a first one may have biases of
// cases, in 64ths of a unit.
struct GivenLayer {
  std::size_t in = 0, out = 0;
  const std::int16_t* weights = nullptr;
  const std::int32_t* bias = nullptr;
  std::uint32_t shift = 0;
  const std::int8_t* cases = nullptr;  // (96, out): biases of rows, then of scales; or there are none
};

// Weights of a layer are left out in tiles of sixteen sums, a block, and four inputs.
inline constexpr std::size_t kBlock = 16, kTileInputs = 4;

inline std::size_t end_of_block(const GivenLayer& layer, std::size_t block) { return std::min(layer.out, (block + 1) * kBlock); }

// Whether all weights of a tile, from input `in` on, are 0.
bool is_tile_empty(const GivenLayer& layer, std::size_t block, std::size_t in);

// Numbers that begin at a line of the processor's cache.
template <class Number>
class Lines {
 public:
  void assign(std::size_t count) {
    lines_.assign((count * sizeof(Number) + sizeof(Line) - 1) / sizeof(Line), Line{});
  }
  Number* data() { return reinterpret_cast<Number*>(lines_.data()); }
  const Number* data() const { return reinterpret_cast<const Number*>(lines_.data()); }

 private:
  struct alignas(64) Line {
    std::array<std::byte, 64> bytes;
  };
  std::vector<Line> lines_;
};

// Of so many blocks of numbers the products, added up.
struct PlainProducts {
  [[gnu::noinline]] static std::int32_t products(const std::int16_t* a, const std::int16_t* b, std::size_t blocks) {
    std::int32_t sum = 0;
    for (std::size_t i = 0; i < blocks * kBlock; ++i) sum += a[i] * b[i];
    return sum;
  }
};

class RiddleNet {
 public:
  // Raises Section unless the layers are 72 or 112 to 32 with 8 to 256 by 8 between, shifts 3 to 13 (of the last one 9 to
  // 13), and no sum can pass 32 bits.
  explicit RiddleNet(const std::array<GivenLayer, kNetLayers>& layers, NetForm form = net_forms_here().back());

  std::size_t inputs() const { return layers_[0].in; }

  // Hidden values and log odds of the tree of one return, or of several at once: weights are fetched once for all of them.
  void run(const std::array<NetValues*, 1>& values) const;
  void run(const std::array<NetValues*, 2>& values) const;
  void run(const std::array<NetValues*, 4>& values) const;

  // Log odds of the first offset bit within a leaf, 0 to 15, of a return that was run.
  template <class Products = PlainProducts>
  std::int16_t leaf_odds(const NetValues& values, std::size_t leaf) const {
    const std::int16_t* const weights = leaves_.weights.data() + leaf * leaves_.blocks * kBlock;
    const std::int32_t sum = leaves_.begins[leaf] + Products::products(weights, values.hidden.data(), leaves_.blocks);
    return static_cast<std::int16_t>(std::clamp(sum >> leaves_.shift, -32768, 32767));
  }

  struct Layer {
    std::size_t in = 0, out = 0;
    std::uint32_t shift = 0;  // of the sums
    std::int32_t low = 0, high = 0;
    // Tiles, block after block, without the empty ones. Weights of sums beyond `out` are 0. Of each tile its first input; of
    // each block, and behind the last one, its first tile.
    std::vector<std::uint16_t> inputs_of;
    std::vector<std::size_t> tiles_of;
    // Of each tile the weights of its first two inputs, a pair for each sum, then those of the other two.
    Lines<std::int16_t> weights;
    // The same as bytes, four for each sum. One plane of them where all weights fit 8 bits; else that of the upper bytes and
    // that of the lower ones, with signs; none where those do not fit.
    std::size_t planes = 0;
    Lines<std::int8_t> byte_weights;
    // What sums begin with: biases, for each row where there are those of cases, and what each scale adds to them. In biases
    // are the half that rounds a sum, and what makes up for inputs that a form takes larger or smaller by 128. Modulo 2^32, as
    // all sums are.
    Lines<std::int32_t> rows, scales;
    bool has_cases = false;
    std::size_t blocks() const { return (out + kBlock - 1) / kBlock; }
    std::size_t tiles() const { return inputs_of.size(); }
  };

 private:
  // The sums of the last layer that are computed one by one: weights of each beside each other, 0 behind the last one.
  struct Leaves {
    std::size_t blocks = 0;
    std::uint32_t shift = 0;
    Lines<std::int16_t> weights;
    std::array<std::int32_t, kLeafOdds> begins{};
  };

  NetForm form_;
  std::array<Layer, kNetLayers> layers_;  // the last one has the tree's sums only
  Leaves leaves_;
};

}  // namespace lidarcodec
