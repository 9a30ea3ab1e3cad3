// Free ranges: cells that are counted from the last return of the row, in sixteenths of a cell, so that a range need not
// change where it stays within the bound. All but the middle cell lie somewhat nearer than whole cells would: what has
// just left the middle cell lies there, and either cell will often do. An encoder then chooses.
// The format is docs/wire-format-predictive.md.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "predictive/forms.hpp"
#include "predictive/range_decisions.hpp"
#include "predictive/row_state.hpp"

namespace lidarcodec {

// Middles of free cells as seen from a base, all in sixteenths.
class FreeCells {
 public:
  // step: range steps in a cell.
  explicit FreeCells(std::uint32_t step) : nearer_(static_cast<std::int32_t>(std::min(step / 5, 4u))) {}

  // The middle of a cell. number: 0 where the base lies.
  std::int32_t middle(std::int32_t base, std::int32_t number) const {
    return base + 16 * number - (number > 0 ? nearer_ : number < 0 ? -nearer_ : 0);
  }

  // Where cells are counted from: the last range, a sixteenth nearer to the middle one of it and two others.
  static std::int32_t base(std::int32_t last, std::int32_t one, std::int32_t other) {
    const std::int32_t low = std::min(one, other), high = std::max(one, other);
    return last + (low > last ? 1 : high < last ? -1 : 0);
  }

 private:
  std::int32_t nearer_;  // how much nearer
};

// Finds the cell of a range within the bound that takes the fewest bits, those of the returns behind it included.
class FreeChoice {
 public:
  FreeChoice(const FreeCells& cells, std::uint32_t step)
      : cells_(cells), step_(static_cast<std::int32_t>(step)), bound_(step_ / 2) {}

  // The number of the cell. at: the return's place in the row; end: where its part ends. Ranges from there on are still as they
  // are: range steps with the row's level.
  std::int32_t cell(const RowWork& row, std::size_t at, std::size_t end, std::int32_t base, const Leaves& leaves,
                    std::uint32_t scale, const Chances& chances) const {
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

  // Of a range outside of the three cells in the middle.
  std::int32_t nearest(std::int32_t range, std::int32_t base, std::int32_t away) const {
    std::int32_t number = away / step_;
    for (;;) {
      const std::int32_t off = range - in_steps(cells_.middle(base, number));
      if (std::abs(off) <= bound_) return number;
      number += off < 0 ? -1 : 1;
    }
  }

  // What a cell takes, in 256ths of a bit.
  static std::int32_t price(std::int32_t number, const Leaves& leaves, std::uint32_t scale, const Chances& chances) {
    const std::uint32_t leaf = leaves.of(scale, number > 0 ? 1 : 0);
    std::int32_t sum = 256 * leaves.bits[scale][leaf];
    for (std::uint32_t node = 16 + (number < 0 ? 7 - leaf : 8 + leaf); node > 1; node /= 2) {
      const std::int32_t one = chances.of[node / 2];
      sum += kBits[static_cast<std::size_t>((node & 1) != 0 ? one : 32767 - one) >> 7];
    }
    return sum;
  }

  // What a value saves later, in 256ths of a bit: returns that come next can stay where it is.
  std::int32_t worth(const RowWork& row, std::size_t at, std::size_t end, std::int32_t value) const {
    std::int32_t sum = 0;
    for (const std::int32_t saved : kSaved) {
      if (++at == end || std::abs(row.ranges[row.cells[at]] - value) > bound_) break;
      sum += saved;
    }
    return sum;
  }

  // What a decision of this probability takes, of 256, in 256ths of a bit: -256 log2((p + 1/2) / 256).
  static constexpr auto kBits = [] {
    std::array<std::int32_t, 256> bits{};
    for (std::uint64_t p = 0; p < bits.size(); ++p) {
      std::uint64_t x = (2 * p + 1) << 20;  // of 2^29
      std::int32_t log = 0;                 // by squaring, bit by bit
      while (x < 1u << 29) x <<= 1, log += 256;
      for (std::int32_t bit = 128; bit > 0; bit /= 2) {
        x = x * x >> 29;
        if (x >= 1u << 30) x >>= 1, log -= bit;
      }
      bits[p] = log;
    }
    return bits;
  }();
  static constexpr std::array<std::int32_t, 10> kSaved = {179, 152, 129, 110, 94, 80, 68, 57, 49, 42};  // 0.7 bit, and 0.85 times that, ...

  const FreeCells& cells_;
  std::int32_t step_, bound_;
};

}  // namespace lidarcodec
