// The contexts of an intensity, and the cells (bits/cells.hpp) of each: seven, and of frames that go on from each other
// two more.
//
// A symbol is coded as the path to its leaf in a binary tree, up to four levels first and then the others. A context
// has cells for the decisions of the first levels, and for each of their ends cells for the others. The contexts are
//
//   0 a guess from symbols around, and the last symbol of the row      1 the last symbol, and the one before
//   2 the one before, and the last                                     3 the last three
//   4 the last four                                                    5 no-return cells since the last return
//   6 no returns beside this one, the last symbol, and the row above
//   7 the row, and the last symbol                                     8 the row, and the last two
//
// mostly in classes with about equal numbers of returns. Symbols of the same row predict best: each laser has its own
// scale, and its intensities alternate, so the symbol before the last one is often closer than the last one. Where
// frames go on from each other, context 0 has what was sent last in this direction in place of the last symbol.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>

#include "bits/cells.hpp"
#include "planes/intensity_symbols.hpp"

// What runs for every return is inlined and its loops are unrolled, but not in the page's decoder, which has to be
// small.
#if defined(__wasm__)
#define LIDARCODEC_EACH_RETURN
#define LIDARCODEC_UNROLL(times) _Pragma("clang loop unroll(disable)")
#else
#define LIDARCODEC_EACH_RETURN [[gnu::always_inline]]
#define LIDARCODEC_PRAGMA(text) _Pragma(#text)
#define LIDARCODEC_UNROLL(times) LIDARCODEC_PRAGMA(GCC unroll times)
#endif

namespace lidarcodec {

inline constexpr std::size_t kContexts = 9, kAloneContexts = 7;
inline constexpr std::uint32_t kRowClasses = 24, kPairClasses = 5;

// Symbols and cells around a return.
struct Surroundings {
  const std::uint8_t* last;   // four symbols of its row, the latest first
  const std::uint8_t* above;  // its cell in the row above; read from -1 to 2
  std::uint8_t gap;           // no-return cells since the last return, 3 for more
  std::uint8_t edges;         // bit 1: the cell to the left is no return, bit 0: the one to the right
  std::uint8_t before;        // class of what was sent last in this direction, 1 to 16; 0: nothing
};

// Where the cells of the contexts lie, and what they begin with, for a tree of any depth: it is found once for a
// section.
class IntensityTables {
 public:
  std::vector<Cells> give_cells() { return std::move(cells_); }

 protected:
  // taught: cells of an earlier model of the same symbols, to go on from; empty: begins anew. follows: frames go on
  // from each other.
  [[gnu::noinline]] IntensityTables(const Symbols& symbols, bool follows, std::vector<Cells>&& taught)
      : depth_(symbols.depth), first_(std::min(depth_, 4)), guesses_(follows ? 17 : 16) {
    second_cells_ = depth_ == first_ ? 0 : depth_ - first_ < 4 ? 1 : 2;
    record_ = 2 + 16 * second_cells_;
    const std::uint32_t fine = fine_class(symbols.count() - 1) + 1;
    const std::array<std::uint32_t, kContexts> sizes = {
        16 * guesses_, 16 * fine, 16 * fine, 512, 1296, 4, 128, 64 * kRowClasses, 64 * kPairClasses * kPairClasses};
    std::uint32_t total = 0;
    for (std::size_t i = 0; i < (follows ? kContexts : kAloneContexts); ++i) {
      begin_[i] = total * record_;
      total += sizes[i];
    }
    for (std::size_t s = 0; s < symbols.count(); ++s) {
      parts_[s] = parts_of(symbols.mass_class[s], fine_class(s));
      of_row_[s] = {symbols.mass_class[s] / 2u * record_, symbols.mass_class[s] / 10u * record_};
    }
    if (taught.size() == total * record_) {
      cells_ = std::move(taught);
      return;
    }
    cells_.resize(total * record_);
    expect_guess(symbols);
    rule_out_empty_leaves(symbols);
  }

  // What a symbol adds to the index of a context's cells, by its place in the surroundings. One cache line.
  struct alignas(64) Parts {
    std::array<std::uint32_t, 6> last;    // to contexts 0 to 4, and 6
    std::array<std::uint32_t, 4> second;  // to contexts 1 to 4
    std::array<std::uint32_t, 2> third;   // to contexts 3 and 4
    std::uint32_t fourth, guess, around;
  };

  // The same of the contexts of a row: of the last symbol, and of each of the last two.
  struct RowParts {
    std::uint32_t last, pair;
  };

  std::uint32_t fine_class(std::size_t symbol) const { return static_cast<std::uint32_t>(symbol >> (depth_ == 8)); }

  Parts parts_of(std::uint32_t mass_class, std::uint32_t fine) const {
    const std::uint32_t in16 = mass_class / 3, in8 = mass_class / 6, in6 = mass_class / 8, in4 = mass_class / 12;
    const std::uint32_t r = record_;
    return {{begin_[0] + in16 * r, begin_[1] + fine * 16 * r, begin_[2] + in16 * r, begin_[3] + in8 * 64 * r,
             begin_[4] + in6 * 216 * r, begin_[6] + in8 * 4 * r},
            {in16 * r, fine * 16 * r, in8 * 8 * r, in6 * 36 * r},
            {in8 * r, in6 * 6 * r},
            in6 * r,
            in16 * guesses_ * r,
            in4 * r};
  }

  // Sets the log odds of one decision: at `level`, on the path `way` from the root.
  void set(Cells* record, int level, std::uint32_t way, int odds) {
    std::uint32_t cell = 0, node = (1u << level) + way;
    if (level >= first_) {
      const int deeper = level - first_;
      cell = 2 + second_cells_ * (way >> deeper);
      node = (1u << deeper) + (way & ((1u << deeper) - 1));
    }
    const auto value = static_cast<std::int16_t>(odds);
    std::memcpy(reinterpret_cast<char*>(record + cell) + sizeof value * node, &value, sizeof value);
  }

  // Context 0 begins with a distribution that decreases on both sides of its guess, by a factor of e in an eighth of
  // the leaves.
  void expect_guess(const Symbols& symbols) {
    const std::size_t n = symbols.count();
    for (std::size_t s = 0, end = 0; s < n; s = end) {
      const std::uint32_t guess = symbols.mass_class[s] / 3u;
      for (end = s + 1; end < n && symbols.mass_class[end] / 3u == guess; ++end) {
      }
      const auto centre = static_cast<std::int32_t>(((s + end) << depth_) / n);  // in half leaves
      Cells* const record = cells_.data() + begin_[0] + guess * guesses_ * record_;
      for (int level = 0; level < depth_; ++level) {
        const std::int32_t half = 1 << (depth_ - level);  // of the leaves below, in half leaves
        for (std::uint32_t way = 0; way < 1u << level; ++way) {
          const std::int32_t middle = (2 * static_cast<std::int32_t>(way) + 1) * half;
          set(record, level, way, std::clamp(centre - middle, -half, half) * 21845 >> depth_);
        }
      }
      for (std::uint32_t other = 1; other < guesses_; ++other) std::copy_n(record, record_, record + other * record_);
    }
  }

  // Context 5 begins with certainty where a side of the tree has no symbols.
  void rule_out_empty_leaves(const Symbols& symbols) {
    for (int level = 0; level < depth_; ++level) {
      const std::uint32_t half = 1u << (depth_ - level - 1);
      for (std::uint32_t way = 0; way < 1u << level; ++way) {
        const auto any = [&](std::uint32_t from) {
          const auto* leaves = symbols.of_leaf.data() + from;
          return std::any_of(leaves, leaves + half, [](std::uint16_t symbol) { return symbol != kNoSymbol; });
        };
        const bool zero = any(2 * way * half), one = any((2 * way + 1) * half);
        if (zero == one) continue;
        for (std::uint32_t gap = 0; gap < 4; ++gap)
          set(cells_.data() + begin_[5] + gap * record_, level, way, one ? 32767 : -32768);
      }
    }
  }

  int depth_, first_;      // levels of the tree, and of those that are coded together first
  std::uint32_t guesses_;  // contexts 0 with the same guess
  std::uint32_t second_cells_ = 0, record_ = 0;
  std::array<Parts, 256> parts_{};
  std::array<RowParts, 256> of_row_{};
  std::array<std::uint32_t, kContexts> begin_{};
  std::vector<Cells> cells_;
};

// `Most` is the depth of the symbols' tree, or a greater one whose records have the same form: 4, 6, 7 or 8. The usual
// depths, 7 and 8, have code of their own; the others share some, which keeps the decoder of the page small. Follows:
// frames go on from each other.
template <int Most, bool Follows>
class IntensityModel : public IntensityTables {
 public:
  static constexpr bool kHasSecond = Most > 4;
  static constexpr std::uint32_t kFirstCells = 2;
  static constexpr std::uint32_t kSecondCells = Most <= 4 ? 0 : Most < 8 ? 1 : 2;
  static constexpr std::uint32_t kRecord = kFirstCells + 16 * kSecondCells;  // cells of a context
  static constexpr std::size_t kNamed = Follows ? kContexts : kAloneContexts;
  using Named = std::array<Cells*, kNamed>;

  IntensityModel(const Symbols& symbols, std::vector<Cells>&& taught)
      : IntensityTables(symbols, Follows, std::move(taught)) {}

  // Levels whose probabilities are computed together first, and the other levels; 0 if only known when it runs.
  static constexpr int kFirst = kHasSecond ? 4 : 0, kSecond = Most >= 7 ? Most - 4 : 0;
  int first_levels() const { return kHasSecond ? kFirst : depth_; }
  int second_levels() const { return kSecond != 0 ? kSecond : depth_ - first_levels(); }

  // Contexts 7 and 8 are those of this row from now on.
  void begin_row(std::size_t row) {
    const auto number = static_cast<std::uint32_t>(row);
    row_ = {begin_[7] + number * (kRowClasses * kRecord), begin_[8] + number * (kPairClasses * kPairClasses * kRecord)};
  }

  // The first cells of each context of a return.
  LIDARCODEC_EACH_RETURN Named contexts(const Surroundings& about) {
    const std::uint8_t *last = about.last, *up = about.above;
    const Parts &a = parts_[last[0]], &b = parts_[last[1]], &c = parts_[last[2]], &d = parts_[last[3]];
    const std::uint32_t guess = (2u * (last[0] + last[1]) + last[2] + last[3] + up[0] + up[1]) / 8;
    const std::uint32_t around = (0u + up[-1] + up[0] + up[1] + up[2]) / 4;
    Cells* const cells = cells_.data();
    Cells* const first = cells + (Follows ? begin_[0] + about.before * kRecord : a.last[0]) + parts_[guess].guess;
    Cells* const second = cells + (a.last[1] + b.second[0]);
    Cells* const third = cells + (a.last[2] + b.second[1]);
    Cells* const fourth = cells + (a.last[3] + b.second[2] + c.third[0]);
    Cells* const fifth = cells + (a.last[4] + b.second[3] + c.third[1] + d.fourth);
    Cells* const sixth = cells + (begin_[5] + about.gap * kRecord);
    Cells* const seventh = cells + (a.last[5] + about.edges * (32 * kRecord) + parts_[around].around);
    if constexpr (Follows) {
      const RowParts &last_one = of_row_[last[0]], &one_before = of_row_[last[1]];
      return {first,
              second,
              third,
              fourth,
              fifth,
              sixth,
              seventh,
              cells + (row_[0] + last_one.last),
              cells + (row_[1] + kPairClasses * one_before.pair + last_one.pair)};
    } else {
      return {first, second, third, fourth, fifth, sixth, seventh};
    }
  }

 private:
  std::array<std::uint32_t, 2> row_{};
};

}  // namespace lidarcodec
