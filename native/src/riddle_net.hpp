// The networks of codec riddle: what a return's surroundings say of its difference, in whole numbers.
//
// Three layers: inputs of 8 bits, two hidden layers clamped to 0..4095, and 32 log odds (cells.hpp). All sums fit 32
// bits, which is checked when a network is made, so that any order of adding gives the same.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

inline constexpr std::size_t kInputsAlone = 72, kInputsExpecting = 112;
inline constexpr std::size_t kMostHidden = 256, kNetOutputs = 32, kNetLayers = 3;
inline constexpr std::int32_t kMiddleTop = 4095;

// Ways to compute: C++ alone, sixteen numbers of 16 bits at a time, thirty-two of them. All give the same.
enum class NetForm { Plain, Avx2, Vnni };

// Those that this processor can run, the quickest last.
std::vector<NetForm> net_forms_here();

// Inputs, -128 to 127, and what comes of them; hidden values between.
struct alignas(64) NetValues {
  std::array<std::int16_t, kInputsExpecting> in{};
  std::array<std::int16_t, kNetOutputs> out{};
};

// A layer as given: weights (out, in), a bias for each sum, and the shift of the weights.
struct GivenLayer {
  std::size_t in = 0, out = 0;
  const std::int16_t* weights = nullptr;
  const std::int32_t* bias = nullptr;
  std::uint32_t shift = 0;
};

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

class RiddleNet {
 public:
  // Raises Section unless the layers are 72 or 112 to 32 with 8 to 256 by 8 between, shifts 5 to 13, and no sum can
  // pass 32 bits.
  explicit RiddleNet(const std::array<GivenLayer, kNetLayers>& layers, NetForm form = net_forms_here().back());

  std::size_t inputs() const { return layers_[0].in; }

  // Log odds of one return, or of two at once, which takes little longer than one.
  void run(NetValues& values) const;
  void run(NetValues& first, NetValues& second) const;

  struct Layer {
    std::size_t in = 0, out = 0;
    std::uint32_t shift = 0;  // of the sums
    std::int32_t low = 0, high = 0;
    // For every two inputs, blocks of 16 sums with a pair of weights each. Sums beyond `out` are 0.
    Lines<std::int16_t> weights;
    Lines<std::int32_t> bias;
    // Of the first layer, where its weights fit 8 bits: for every four inputs, blocks of 16 sums with four weights each, for
    // inputs that are larger by 128, and biases that are smaller by as much as that makes. Modulo 2^32, as all sums are.
    bool in_bytes = false;
    Lines<std::int8_t> byte_weights;
    Lines<std::int32_t> byte_bias;
    std::size_t blocks() const { return (out + 15) / 16; }
  };

 private:
  NetForm form_;
  std::array<Layer, kNetLayers> layers_;
};

}  // namespace lidarcodec
