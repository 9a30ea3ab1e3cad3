// The model of a mask's cells in a stream with memory.
//
// A logistic regression over sixteen contexts (native/src/bits/README.md, Cells): each has a cell of log odds, their
// sum gives the probability of a return, and each moves by rate times error. A first model, the *gate*, has the counts
// of holes nearby as its context. Where its probability is near 0 or 1 it is used alone, which saves time.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bits/bitmodel.hpp"

namespace lidarcodec {

inline constexpr std::size_t kCellContexts = 16;

// log2 of the number of cells of each context.
inline constexpr std::array<std::uint32_t, kCellContexts> kContextBits = {7,  11, 10, 12, 11, 11, 10, 11,
                                                                          11, 11, 11, 11, 12, 13, 12, 12};
// First cell of each context; then the number of all cells.
inline constexpr auto kCellsBegin = [] {
  std::array<std::uint32_t, kCellContexts + 1> begins{};
  for (std::size_t i = 0; i < kCellContexts; ++i) begins[i + 1] = begins[i] + (1u << kContextBits[i]);
  return begins;
}();

// The context numbers of adjacent cells of a row, [context][cell], without the part of the cells to the left.
inline constexpr std::size_t kContextBlock = 16;
using ContextBlock = std::array<std::array<std::uint16_t, kContextBlock>, kCellContexts>;

inline constexpr std::uint32_t kGateBits = 14;  // log2 of the number of gates

// The class of a count is the number of these limits that it reaches: two an octave.
inline constexpr std::array<std::uint8_t, 13> kCountLimits = {1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128};
inline constexpr auto kCountClass = [] {
  std::array<std::uint8_t, 256> classes{};
  for (std::size_t count = 0; count < classes.size(); ++count)
    for (const std::uint8_t limit : kCountLimits)
      classes[count] = static_cast<std::uint8_t>(classes[count] + (count >= limit));
  return classes;
}();

// Class of the number of holes among twelve cells.
inline constexpr std::array<std::uint8_t, 13> kHoleClass = {0, 1, 2, 2, 3, 3, 3, 3, 3, 3, 3, 3, 3};

// The state of the cells to the left.
struct LeftCells {
  std::uint32_t bits = ~0u;  // the nearest cell lowest
  std::uint32_t holes = 0;   // among the last 12
  std::uint32_t run = 0;     // number of equal cells before the nearest one, at most 7

  void take(bool bit) {
    run = bit == (bits & 1u) ? std::min(run + 1, 7u) : 0;
    holes = holes + !bit - (~bits >> 11 & 1u);
    bits = bits << 1 | static_cast<std::uint32_t>(bit);
  }
  std::uint32_t hole_class() const { return kHoleClass[holes]; }
};

// Weights of the part of the cells to the left in the number of each context: of the nearest cell, the one before, the
// run, and the class of holes. Bit 0 of all numbers is the nearest cell.
struct LeftContext {
  std::array<std::uint16_t, kCellContexts> last{}, before{}, run{}, holes{};

  constexpr LeftContext() {
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
inline constexpr LeftContext kLeftContext;

// The cells of log odds of a decision, in plain C++. No two contexts share a cell.
class PlainLogOdds {
 public:
  explicit PlainLogOdds(std::int16_t* cells) : cells_(cells) {}

  // The context numbers of a block, in the order that is read fastest.
  using Block = ContextBlock;
  static void put_block(const ContextBlock& from, Block& block) { block = from; }

  // The sum of log odds for cell k of a block.
  std::int32_t sum(const Block& block, std::size_t k, const LeftCells& left) {
    const std::uint32_t last = left.bits & 1u, before = left.bits >> 1 & 1u, holes = kCountClass[left.holes];
    std::int32_t sum = 0;
    for (std::size_t i = 0; i < kCellContexts; ++i) {
      at_[i] = cells_ + block[i][k] + last + before * kLeftContext.before[i] + left.run * kLeftContext.run[i] +
               holes * kLeftContext.holes[i];
      sum += *at_[i];
    }
    return sum;
  }

  // Adds `by`, of a size below 2^14, to the cells of the last sum.
  void move(std::int32_t by) {
    for (std::int16_t* const at : at_) *at = static_cast<std::int16_t>(std::clamp(*at + by, -kMost, kMost));
  }

  void end() {}

 private:
  static constexpr std::int32_t kMost = 32767;

  std::int16_t* cells_;
  std::array<std::int16_t*, kCellContexts> at_{};
};

// The logistic function kSquash, kept kMinProbability away from 0 and 1.
inline constexpr auto kCellProbability = [] {
  auto probability = kSquash;
  for (std::uint16_t& p : probability)
    p = static_cast<std::uint16_t>(std::clamp<std::uint32_t>(p, kMinProbability, 65536u - kMinProbability));
  return probability;
}();

class MaskModel {
 public:
  static constexpr std::int32_t kRate =
      123;  // learning rate: 0.03 natural units (4096 steps each); no update is larger

  MaskModel() { forget(); }

  void forget() {
    gates_.assign(std::size_t{1} << kGateBits, BitModel());
    cells_.assign(kCellsBegin.back(), 0);
    remainder_ = 0;
  }

  static bool sure(std::uint32_t probability) { return probability < kGateLimit || probability > 65536u - kGateLimit; }

  std::int16_t* cells() { return cells_.data(); }
  BitModel* gates() { return gates_.data(); }
  std::int32_t& remainder() { return remainder_; }

  // The probability of a return, of 65536, by a sum of log odds.
  static std::uint32_t probability(std::int32_t sum) {
    return kCellProbability[static_cast<std::size_t>(std::clamp(sum >> kFraction, -2048, 2047) + 2048)];
  }
  // The update of log odds, rate times error. remainder: carries the rounding error to the next update, so that small
  // errors add up.
  static std::int32_t move(bool bit, std::uint32_t probability, std::int32_t& remainder) {
    const std::int32_t moves = ((bit ? 65536 : 0) - static_cast<std::int32_t>(probability)) * kRate + remainder;
    remainder = moves & 0xFFFF;
    return moves >> 16;
  }

 private:
  static constexpr std::uint32_t kGateLimit =
      256;                             // the gate is used alone below this, of 65536, and above 65536 minus this
  static constexpr int kFraction = 4;  // log odds are in steps of 1/4096, those of kSquash of 1/256

  std::vector<BitModel> gates_;
  std::vector<std::int16_t> cells_;
  std::int32_t remainder_ = 0;  // rounding error of the last update, of 65536
};

}  // namespace lidarcodec
