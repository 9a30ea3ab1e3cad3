// The levels that a return may get, and what each of them costs together with the rest of its row.
//
// A cost is 16 times a squared error, or a number of bits times lambda. In whole numbers, so every machine gives the
// same.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

namespace lidarcodec {

using Cost = std::int32_t;
inline constexpr Cost kNever = 1 << 28;        // of a level that does not exist
inline constexpr std::size_t kCandidates = 4;  // levels that a return may get

// 256 log2(x), rounded down; x is not 0. A bit of the fraction comes from squaring the mantissa.
constexpr std::uint32_t log2_256(std::uint32_t x) {
  const int whole = std::bit_width(x) - 1;
  std::uint64_t part = std::uint64_t{x} << (31 - whole);
  auto log = static_cast<std::uint32_t>(whole);
  for (int bit = 0; bit < 8; ++bit) {
    part = part * part >> 31;
    const bool one = part >> 32 != 0;
    log = 2 * log + one;
    part >>= one;
  }
  return log;
}

// The cost of a bit: the Lagrange multiplier between error and rate.
struct Lambda {
  Cost bit;
  Cost of(std::uint32_t bits_256) const { return static_cast<Cost>(std::int64_t{bit} * bits_256 >> 8); }
};

// The kCandidates levels nearest to each intensity.
class Candidates {
 public:
  struct Choices {
    std::array<Cost, kCandidates> error;  // kNever beyond the last level
    std::uint8_t first;                   // the others are the levels after it
    std::uint8_t nearest;
  };

  // value: of each level, rising.
  explicit Candidates(const std::vector<std::uint8_t>& value) {
    const std::size_t n = value.size();
    const auto off = [&](std::size_t x, std::size_t level) {
      return level < n ? std::abs(static_cast<int>(x) - value[level]) : 256;
    };
    std::size_t first = 0;
    for (std::size_t x = 0; x < of_.size(); ++x) {
      while (off(x, first + kCandidates) < off(x, first)) ++first;
      Choices& choices = of_[x];
      choices.first = static_cast<std::uint8_t>(first);
      for (std::size_t i = 0; i < kCandidates; ++i) {
        const int error = off(x, first + i);
        choices.error[i] = error == 256 ? kNever : 16 * error * error;
      }
      const auto least = std::min_element(choices.error.begin(), choices.error.end());
      choices.nearest = static_cast<std::uint8_t>(least - choices.error.begin() + choices.first);
    }
  }
  const Choices& of(std::uint8_t intensity) const { return of_[intensity]; }

 private:
  std::array<Choices, 256> of_{};
};

// The cost of a return's level after the level of the return before: a first-order Markov model of rows.
class Transitions {
 public:
  explicit Transitions(std::size_t levels) : stride_(std::max(levels, kCandidates)), counts_(stride_ * stride_) {}

  void count(std::size_t before, std::size_t level) { ++counts_[before * stride_ + level]; }

  // Computes the costs from the transitions counted since the last call.
  void learn(Lambda lambda) {
    cost_.resize(counts_.size());
    for (std::size_t from = 0; from < counts_.size(); from += stride_) {
      std::uint32_t all = 0;
      for (std::size_t to = 0; to < stride_; ++to) all += counts_[from + to];
      const std::uint32_t total = log2_256(2 * all + static_cast<std::uint32_t>(stride_));
      for (std::size_t to = 0; to < stride_; ++to)
        cost_[from + to] = lambda.of(total - log2_256(2 * counts_[from + to] + 1));
    }
    std::fill(counts_.begin(), counts_.end(), 0);
  }
  const Cost* after(std::size_t level) const { return cost_.data() + level * stride_; }

 private:
  std::size_t stride_;
  std::vector<std::uint32_t> counts_;
  std::vector<Cost> cost_;
};

// For each candidate of a return the least cost of the rest of the row, relative to the best candidate: the cost-to-go
// of dynamic programming.
class CostToGo {
 public:
  using Costs = std::array<Cost, kCandidates>;

  void compute(const Candidates& candidates, const Transitions& transitions, const std::uint8_t* intensities,
               std::size_t count) {
    costs_.resize(std::max(costs_.size(), count + 1));
    if (count == 0) return;
    costs_[count - 1] = {};
    for (std::size_t k = count - 1; k-- > 0;) {
      const Candidates::Choices &here = candidates.of(intensities[k]), &next = candidates.of(intensities[k + 1]);
      Costs then;
      for (std::size_t i = 0; i < kCandidates; ++i) then[i] = next.error[i] + costs_[k + 1][i];
      Costs& costs = costs_[k];
      for (std::size_t s = 0; s < kCandidates; ++s) {
        const Cost* transition = transitions.after(here.first + s) + next.first;
        Cost least = kNever;
        for (std::size_t i = 0; i < kCandidates; ++i) least = std::min(least, transition[i] + then[i]);
        costs[s] = least;
      }
      const Cost least = *std::min_element(costs.begin(), costs.end());
      for (Cost& cost : costs) cost -= least;
    }
  }
  const Costs& of(std::size_t at) const { return costs_[at]; }

 private:
  std::vector<Costs> costs_;
};

}  // namespace lidarcodec
