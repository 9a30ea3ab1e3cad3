// Free ranges: cells are counted from the last return of the row, so a range can stay the same as long as it is within
// the bound. Cells other than the middle one are shifted towards it: ranges that have just left the middle cell lie
// close to it. The cells then overlap, and an encoder may choose, as in rate-distortion optimised quantisation
// (Sullivan and Wiegand, "Rate-distortion optimization for video compression", 1998). README.md in this folder derives
// the prices. The format is docs/wire-format-predictive.md.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "predictive/forms.hpp"
#include "predictive/range_decisions.hpp"
#include "predictive/row_state.hpp"

namespace lidarcodec {

// The middles of free cells, in sixteenths of a cell.
class FreeCells {
 public:
  // step: range steps in a cell.
  explicit FreeCells(std::uint32_t step) : shift_(static_cast<std::int32_t>(std::min(step / 5, 4u))) {}

  // The middle of a cell. number: 0 for the cell around the base.
  std::int32_t middle(std::int32_t base, std::int32_t number) const {
    return base + 16 * number - (number > 0 ? shift_ : number < 0 ? -shift_ : 0);
  }

  // The base: the last range, moved by a sixteenth towards the median of it and two other predictions.
  static std::int32_t base(std::int32_t last, std::int32_t one, std::int32_t other) {
    const std::int32_t low = std::min(one, other), high = std::max(one, other);
    return last + (low > last ? 1 : high < last ? -1 : 0);
  }

 private:
  std::int32_t shift_;  // towards the base, at most a quarter of a cell
};

// Chooses the cell of a range within the bound, by its bits and an estimate of what it saves later (README.md).
class FreeChoice {
 public:
  FreeChoice(const FreeCells& cells, std::uint32_t step)
      : cells_(cells), step_(static_cast<std::int32_t>(step)), bound_(step_ / 2) {}

  // The number of the cell. at: the index of the return in the row; end: that of the end of its part. Ranges from `at`
  // on are not yet coded: they are range steps plus the row's level.
  std::int32_t cell(const RowTask& row, std::size_t at, std::size_t end, std::int32_t base, const Leaves& leaves,
                    std::uint32_t scale, const Probabilities& chances) const {
    const std::int32_t range = row.ranges[row.cells[at]], away = range - in_steps(base);
    const std::int32_t side = away < 0 ? -1 : 1, near = in_steps(cells_.middle(base, side));
    if (std::abs(range - near) > bound_) return std::abs(away) <= bound_ ? 0 : nearest(range, base, away);
    if (std::abs(away) > bound_) return side;
    const std::int32_t stay = price(0, leaves, scale, chances) - worth(row, at, end, in_steps(base));
    const std::int32_t leave = price(side, leaves, scale, chances) - worth(row, at, end, near);
    return leave < stay ? side : 0;
  }

 private:
  std::int32_t in_steps(std::int32_t sixteenths) const { return (sixteenths * step_ + 8) >> 4; }

  // The nearest cell, for a range outside of the three middle cells.
  std::int32_t nearest(std::int32_t range, std::int32_t base, std::int32_t away) const {
    std::int32_t number = away / step_;
    for (;;) {
      const std::int32_t off = range - in_steps(cells_.middle(base, number));
      if (std::abs(off) <= bound_) return number;
      number += off < 0 ? -1 : 1;
    }
  }

  // The cost of a cell, in 1/256 bit.
  static std::int32_t price(std::int32_t number, const Leaves& leaves, std::uint32_t scale,
                            const Probabilities& chances) {
    const std::uint32_t leaf = leaves.of(scale, number > 0 ? 1 : 0);
    std::int32_t sum = 256 * leaves.bits[scale][leaf];
    for (std::uint32_t node = 16 + (number < 0 ? 7 - leaf : 8 + leaf); node > 1; node /= 2) {
      const std::int32_t one = chances.of[node / 2];
      sum += kBits[static_cast<std::size_t>((node & 1) != 0 ? one : 32767 - one) >> 7];
    }
    return sum;
  }

  // What a value saves later, in 1/256 bit: the next returns can stay at it.
  std::int32_t worth(const RowTask& row, std::size_t at, std::size_t end, std::int32_t value) const {
    std::int32_t sum = 0;
    for (const std::int32_t saved : kSaved) {
      if (++at == end || std::abs(row.ranges[row.cells[at]] - value) > bound_) break;
      sum += saved;
    }
    return sum;
  }

  // The cost of a decision with the probability p of 256, in 1/256 bit: -256 log2((p + 1/2) / 256), by repeated
  // squaring.
  static constexpr auto kBits = [] {
    std::array<std::int32_t, 256> bits{};
    for (std::uint64_t p = 0; p < bits.size(); ++p) {
      std::uint64_t x = (2 * p + 1) << 20;  // (p + 1/2) / 256, with 29 fractional bits
      std::int32_t log = 0;
      while (x < 1u << 29) x <<= 1, log += 256;
      for (std::int32_t bit = 128; bit > 0; bit /= 2) {
        x = x * x >> 29;
        if (x >= 1u << 30) x >>= 1, log -= bit;
      }
      bits[p] = log;
    }
    return bits;
  }();
  // What each of the next returns saves if it stays, in 1/256 bit: kStayBits kStayDecay^i, fitted to KITTI drives.
  static constexpr double kStayBits = 0.7, kStayDecay = 0.85;
  static constexpr auto kSaved = [] {
    std::array<std::int32_t, 10> saved{};
    double bits = 256 * kStayBits;
    for (std::int32_t& s : saved) s = static_cast<std::int32_t>(bits + 0.5), bits *= kStayDecay;
    return saved;
  }();

  const FreeCells& cells_;
  std::int32_t step_, bound_;
};

}  // namespace lidarcodec
