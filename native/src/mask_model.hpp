// The model of a mask's cells in a stream with memory.
//
// Sixteen contexts have a cell of log odds each; their sum says how likely a return is, and all are moved by the error.
// Where a first model, by counts of holes around the cell, is sure already, it is used alone: more than half of the cells.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bitmodel.hpp"

namespace lidarcodec {

inline constexpr std::size_t kCellContexts = 16;

// Bits of the number of each context.
inline constexpr std::array<std::uint32_t, kCellContexts> kContextBits = {7,  11, 10, 12, 11, 11, 10, 11,
                                                                         11, 11, 11, 11, 12, 13, 12, 12};
// Where the cells of each context begin; then how many there are.
inline constexpr auto kCellsBegin = [] {
  std::array<std::uint32_t, kCellContexts + 1> begins{};
  for (std::size_t i = 0; i < kCellContexts; ++i) begins[i + 1] = begins[i] + (1u << kContextBits[i]);
  return begins;
}();
using CellContexts = std::array<std::uint32_t, kCellContexts>;  // numbers of cells

inline constexpr std::uint32_t kGateBits = 14;

// The class of a count is how many of these it reaches.
inline constexpr std::array<std::uint8_t, 13> kCountLimits = {1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128};
inline constexpr auto kCountClass = [] {
  std::array<std::uint8_t, 256> classes{};
  for (std::size_t count = 0; count < classes.size(); ++count)
    for (const std::uint8_t limit : kCountLimits) classes[count] = static_cast<std::uint8_t>(classes[count] + (count >= limit));
  return classes;
}();

class MaskModel {
 public:
  MaskModel() { forget(); }

  void forget() {
    gates_.assign(std::size_t{1} << kGateBits, BitModel());
    cells_.assign(kCellsBegin.back(), 0);
    left_over_ = 0;
  }

  BitModel& gate(std::uint32_t number) { return gates_[number]; }
  static bool sure(std::uint32_t probability) { return probability < kSure || probability > 65536u - kSure; }

  // Writes or reads a cell by its contexts.
  template <class Bits>
  bool code(Bits& bits, bool value, const CellContexts& contexts) {
    std::array<std::int16_t*, kCellContexts> at;
    std::int32_t sum = 0;
    for (std::size_t i = 0; i < kCellContexts; ++i) {
      at[i] = cells_.data() + contexts[i];
      sum += *at[i];
    }
    const std::uint32_t likely = kSquash[static_cast<std::size_t>(std::clamp(sum >> kFraction, -2048, 2047) + 2048)];
    const std::uint32_t probability = std::clamp(likely, kSurest, 65536u - kSurest);
    const bool bit = bits.bit(value, probability);
    const std::int32_t error = (bit ? 65536 : 0) - static_cast<std::int32_t>(probability);
    const std::int32_t moves = error * kRate + left_over_;
    left_over_ = moves & 0xFFFF;
    const std::int32_t by = moves >> 16;
    if (by == 0) return bit;
    for (std::size_t i = 0; i < kCellContexts; ++i)
      *at[i] = static_cast<std::int16_t>(std::clamp(*at[i] + by, -kMost, kMost));
    return bit;
  }

 private:
  static constexpr std::uint32_t kSure = 256;    // 1 in 256
  static constexpr int kFraction = 4;            // log odds are in steps of 1/4096, those of kSquash of 1/256
  static constexpr std::int32_t kRate = 123;     // 0.03
  static constexpr std::int32_t kMost = 32767;

  std::vector<BitModel> gates_;
  std::vector<std::int16_t> cells_;
  std::int32_t left_over_ = 0;  // of the last move, less than a step: errors of one sign add up to steps
};

}  // namespace lidarcodec
