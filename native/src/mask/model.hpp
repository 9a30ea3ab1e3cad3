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

#include "bits/bitmodel.hpp"

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

// Contexts of some cells that lie beside each other, one after the other: all of their numbers but what lies to the left.
inline constexpr std::size_t kContextBlock = 16;
using ContextBlock = std::array<std::array<std::uint16_t, kContextBlock>, kCellContexts>;

inline constexpr std::uint32_t kGateBits = 14;

// The class of a count is how many of these it reaches.
inline constexpr std::array<std::uint8_t, 13> kCountLimits = {1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128};
inline constexpr auto kCountClass = [] {
  std::array<std::uint8_t, 256> classes{};
  for (std::size_t count = 0; count < classes.size(); ++count)
    for (const std::uint8_t limit : kCountLimits) classes[count] = static_cast<std::uint8_t>(classes[count] + (count >= limit));
  return classes;
}();

// Classes of holes among twelve cells.
inline constexpr std::array<std::uint8_t, 13> kFew = {0, 1, 2, 2, 3, 3, 3, 3, 3, 3, 3, 3, 3};

// The cells to the left.
struct LeftCells {
  std::uint32_t bits = ~0u;   // the last one lowest
  std::uint32_t holes = 0;    // among the last 12
  std::uint32_t run = 0;      // equal ones before the last one

  void take(bool bit) {
    run = bit == (bits & 1u) ? std::min(run + 1, 7u) : 0;
    holes = holes + !bit - (~bits >> 11 & 1u);
    bits = bits << 1 | static_cast<std::uint32_t>(bit);
  }
  std::uint32_t few() const { return kFew[holes]; }
};

// What is added to the numbers of contexts for what lies to the left: the last cell, the one before, the run, and the class
// of holes. All contexts begin with the last cell; further ones are where there is room for them.
struct AddedLeft {
  std::array<std::uint16_t, kCellContexts> last{}, before{}, run{}, holes{};

  constexpr AddedLeft() {
    last.fill(1);
    before[0] = 1 << 6;
    run[1] = 1 << 8;
    before[2] = 1 << 9;
    before[5] = 1 << 2;
    holes[10] = 1 << 8;
    holes[13] = 1 << 3;
    run[13] = 1 << 10;
    before[14] = 1 << 10;
  }
};
inline constexpr AddedLeft kAddedLeft;

// The cells of log odds of a decision, in plain C++; none is in two contexts.
class PlainOdds {
 public:
  explicit PlainOdds(std::int16_t* cells) : cells_(cells) {}

  // Numbers of the contexts of a block, as they are read best.
  using Block = ContextBlock;
  static void put_block(const ContextBlock& from, Block& block) { block = from; }

  // The sum for cell k of a block.
  std::int32_t sum(const Block& block, std::size_t k, const LeftCells& left) {
    const std::uint32_t last = left.bits & 1u, before = left.bits >> 1 & 1u, holes = kCountClass[left.holes];
    std::int32_t sum = 0;
    for (std::size_t i = 0; i < kCellContexts; ++i) {
      at_[i] = cells_ + block[i][k] + last + before * kAddedLeft.before[i] + left.run * kAddedLeft.run[i] + holes * kAddedLeft.holes[i];
      sum += *at_[i];
    }
    return sum;
  }

  // Moves them by less than 2^14.
  void move(std::int32_t by) {
    for (std::int16_t* const at : at_) *at = static_cast<std::int16_t>(std::clamp(*at + by, -kMost, kMost));
  }

  void end() {}

 private:
  static constexpr std::int32_t kMost = 32767;

  std::int16_t* cells_;
  std::array<std::int16_t*, kCellContexts> at_{};
};

// kSquash, not too sure.
inline constexpr auto kLikely = [] {
  auto likely = kSquash;
  for (std::uint16_t& p : likely) p = static_cast<std::uint16_t>(std::clamp<std::uint32_t>(p, kMinProbability, 65536u - kMinProbability));
  return likely;
}();

class MaskModel {
 public:
  static constexpr std::int32_t kRate = 123;  // 0.03: no move is farther

  MaskModel() { forget(); }

  void forget() {
    gates_.assign(std::size_t{1} << kGateBits, BitModel());
    cells_.assign(kCellsBegin.back(), 0);
    left_over_ = 0;
  }

  static bool sure(std::uint32_t probability) { return probability < kSure || probability > 65536u - kSure; }

  std::int16_t* cells() { return cells_.data(); }
  BitModel* gates() { return gates_.data(); }
  std::int32_t& left_over() { return left_over_; }

  // Probability of a return by a sum of log odds.
  static std::uint32_t likely(std::int32_t sum) {
    return kLikely[static_cast<std::size_t>(std::clamp(sum >> kFraction, -2048, 2047) + 2048)];
  }
  // By how much the log odds are to be moved when a cell was this likely a return.
  static std::int32_t move(bool bit, std::uint32_t likely, std::int32_t& left_over) {
    const std::int32_t moves = ((bit ? 65536 : 0) - static_cast<std::int32_t>(likely)) * kRate + left_over;
    left_over = moves & 0xFFFF;
    return moves >> 16;
  }

 private:
  static constexpr std::uint32_t kSure = 256;    // 1 in 256
  static constexpr int kFraction = 4;            // log odds are in steps of 1/4096, those of kSquash of 1/256

  std::vector<BitModel> gates_;
  std::vector<std::int16_t> cells_;
  std::int32_t left_over_ = 0;  // of the last move, less than a step: errors of one sign add up to steps
};

}  // namespace lidarcodec
