// The features of the cells of a row that do not depend on the row itself, computed for a whole row at a time, and the
// context numbers of blocks of cells, without the part of the cells to the left.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/model.hpp"
#include "mask/places.hpp"
#include "mask/rows.hpp"

namespace lidarcodec {

class MaskWindows {
 public:
  static constexpr std::size_t kBlock = kContextBlock, kStep = 32;
  static constexpr std::size_t kRoom = kStep;  // features are computed for so many more cells

  explicit MaskWindows(std::size_t width) : here(width + kRoom), place(width + kRoom), gate(width + kRoom) {
    for (PaddedRow* row :
         {&above_,        &above2_,       &above3_,      &below_,      &place_above_, &place_below_, &one_,
          &two_,          &four_,         &eight_,       &above_bits_, &above2_bits_, &above3_bits_, &turn_bits_,
          &turn2_bits_,   &turn3_bits_,   &holes_above_, &holes_wide_, &changed_,     &holes_here_,  &holes_new_,
          &holes_ever_,   &about_,        &near_,        &rough_,      &above_class_, &wide_class_,  &changed_class_,
          &around_class_, &places_class_, &ever_class_})
      *row = PaddedRow(width + kRoom);
  }

  // Computes the features of the row that a frame has begun, of n cells. expected: expected ranges, padded; or nullptr.
  template <class Forms>
  void begin_row(const MaskFrame& frame, std::size_t row, std::size_t n, const std::uint16_t* expected) {
    frame.beams<Forms>({&above3_, &above2_, &above_, &here, &below_});
    frame.places<Forms>({&place_above_, &place, &place_below_});
    const std::size_t all = n + 2 * kMargin;
    const std::uint8_t *const u = first(above_), *const v = first(above2_), *const w = first(above3_),
                              *const h = first(here), *const b = first(below_), *const p = first(place),
                              *const pa = first(place_above_), *const pb = first(place_below_);
    std::uint8_t* const c = first(one_);
    fill(c, all, [=](std::size_t i) { return (~u[i] & 1) + (~v[i] & 1) + (~w[i] & 1); });
    sum(n, holes_above_);
    const std::uint8_t* const eight = first(eight_);
    fill(holes_wide_.cells(), n, [=](std::size_t k) { return eight[k] + eight[k + 8] + c[k + 16]; });
    fill(c, all, [=](std::size_t i) { return ((u[i] ^ u[i] >> 1) & 1) + ((v[i] ^ v[i] >> 1) & 1); });
    sum(n, changed_);
    fill(c, all, [=](std::size_t i) {
      return zeros(static_cast<std::uint8_t>(h[i] | 0xF0)) + zeros(static_cast<std::uint8_t>(b[i] | 0xF8));
    });
    sum(n, holes_here_);
    fill(c, all, [=](std::size_t i) { return (~p[i] & 1) + (~p[i] >> 1 & 1) + (~pa[i] & 1) + (~pb[i] & 1); });
    sum(n, holes_new_);
    fill(c, all, [=](std::size_t i) { return zeros(p[i]) + ((zeros(pa[i]) + zeros(pb[i]) + 1) >> 1); });
    sum(n, holes_ever_);
    fill(c, all, [=](std::size_t i) { return ~h[i] & 1; });
    sum(n, about_);
    pack(above_, 0, n, above_bits_);
    pack(above2_, 0, n, above2_bits_);
    pack(above3_, 0, n, above3_bits_);
    pack(here, 0, n, turn_bits_);
    pack(here, 1, n, turn2_bits_);
    pack(here, 2, n, turn3_bits_);
    classify_expected(n, expected);
    number_gates(n);
    row_ = static_cast<unsigned>(row);
  }

  // The context numbers of a block of this row, without the part of the cells to the left. a1, a2, a3: eight cells of
  // each of the three rows above; t1, t2, t3: eight cells of this row in each of the last three turns. Bit 3 is the
  // cell itself (pack).
  void number_contexts(std::size_t begin, ContextBlock& to) const {
    const auto at = [begin](const PaddedRow& cells) { return cells.cells() + begin; };
    const unsigned row = row_;
    const std::uint8_t *const a1 = at(above_bits_), *const a2 = at(above2_bits_), *const a3 = at(above3_bits_),
                              *const t1 = at(turn_bits_), *const t2 = at(turn2_bits_), *const t3 = at(turn3_bits_);
    const std::uint8_t *const h = at(here), *const b = at(below_), *const p = at(place), *const u = at(above_);
    const std::uint8_t *const near = at(near_), *const rough = at(rough_), *const about = at(about_);
    const std::uint8_t *const over = at(above_class_), *const wide = at(wide_class_),
                              *const changed = at(changed_class_), *const around = at(around_class_),
                              *const there = at(places_class_), *const ever = at(ever_class_);
    // Bit 1: the cell above; bit 2: this cell a turn ago; bit 0 is for the cell to the left.
    std::array<std::uint8_t, kBlock> twos;
    std::uint8_t* const two = twos.data();
    fill_block(two, [=](std::size_t k) { return (a1[k] >> 3 & 1) << 1 | (t1[k] >> 3 & 1) << 2; });
    const auto context = [&](std::size_t i, auto value) {
      fill_block(to[i].data(), [=](std::size_t k) { return kCellsBegin[i] + static_cast<unsigned>(value(k)); });
    };
    context(0, [=](std::size_t k) {
      const auto c = static_cast<std::uint8_t>(3 - reaches<std::uint8_t>(about[k], 1) -
                                               reaches<std::uint8_t>(about[k], 3) - reaches<std::uint8_t>(about[k], 9));
      return two[k] | (a2[k] >> 4 & 1u) << 3 | c << 4;
    });
    context(1, [=](std::size_t k) {
      return two[k] | (a1[k] >> 2 & 1u) << 3 | (a1[k] >> 4 & 1u) << 4 | (t1[k] & 1u) << 5 | (t1[k] >> 2 & 1u) << 6 |
             (t1[k] >> 4 & 1u) << 7;
    });
    context(2, [=](std::size_t k) { return (two[k] & 2u) | (t1[k] & 127u) << 2; });
    context(3, [=](std::size_t k) {
      return two[k] | near[k] << 3 | near[static_cast<std::ptrdiff_t>(k) - 1] << 6 | near[k + 1] << 9;
    });
    context(4, [=](std::size_t k) {
      const std::uint8_t holes = zeros(static_cast<std::uint8_t>(h[k] | 1u));
      return two[k] | near[k] << 3 | rough[k] << 6 |
             (2 - reaches<std::uint8_t>(holes, 2) - reaches<std::uint8_t>(holes, 5)) << 9;
    });
    context(5, [=](std::size_t k) { return (two[k] & 4u) >> 1 | a1[k] << 3; });
    context(6, [=](std::size_t k) {
      return two[k] | (a2[k] >> 2 & 15u) << 3 | (a3[k] >> 3 & 3u) << 7 | (a1[k] >> 4 & 1u) << 9;
    });
    context(7, [=](std::size_t k) { return two[k] | (t2[k] >> 1 & 31u) << 3 | (t3[k] >> 2 & 7u) << 8; });
    context(8, [=](std::size_t k) { return (two[k] & 2u) | near[k] << 2 | row << 5; });
    context(9, [=](std::size_t k) { return two[k] | changed[k] << 3 | around[k] << 7; });
    context(10, [=](std::size_t k) { return two[k] | (p[k] & 1u) << 3 | there[k] << 4; });
    context(11, [=](std::size_t k) { return two[k] | p[k] << 3; });
    context(12, [=](std::size_t k) { return two[k] | (t1[k] >> 4 & 1u) << 3 | ever[k] << 4 | over[k] << 8; });
    context(13, [=](std::size_t k) { return (two[k] & 2u) | (a1[k] >> 4 & 1u) << 2 | wide[k] << 6; });
    context(14, [=](std::size_t k) {
      return two[k] | (h[k] >> 1 & 3u) << 3 | (t1[k] >> 4 & 1u) << 5 | (t1[k] >> 2 & 1u) << 6 | (b[k] & 1u) << 7 |
             (b[k + 1] & 1u) << 8 | (a1[k] >> 4 & 1u) << 9 | (u[k] >> 1 & 1u) << 11;
    });
    context(15, [=](std::size_t k) { return two[k] | row << 3 | at_most_7(there[k]) << 9; });
  }

  PaddedRow here, place;            // history bytes of the direction of each cell and of its place
  std::vector<std::uint16_t> gate;  // number of the gate

 private:
  static constexpr std::size_t kMargin = PaddedRow::kMargin;
  static std::uint8_t* first(PaddedRow& row) { return row.cells() - kMargin; }
  static const std::uint8_t* first(const PaddedRow& row) { return row.cells() - kMargin; }

  // to[i] = value(i), vectorised: `value` reads nothing from `to`. Computes up to kStep - 1 more, so that no scalar
  // loop remains.
  template <class Number, class Value>
  static void fill(Number* __restrict to, std::size_t n, Value value) {
    for (std::size_t begin = 0; begin < n; begin += kStep) {
#if defined(__clang__)
#pragma clang loop interleave(disable) unroll(disable)  // small, for the page
#elif defined(__GNUC__)
#pragma GCC unroll 1
#endif
      for (std::size_t i = begin; i < begin + kStep; ++i) to[i] = static_cast<Number>(value(i));
    }
  }

  template <class Number, class Value>
  static void fill_block(Number* __restrict to, Value value) {
#if defined(__clang__)
#pragma clang loop interleave(disable) unroll(disable)
#elif defined(__GNUC__)
#pragma GCC unroll 1
#endif
    for (std::size_t i = 0; i < kBlock; ++i) to[i] = static_cast<Number>(value(i));
  }

  static constexpr std::uint8_t zeros(std::uint8_t byte) {
    auto x = static_cast<std::uint8_t>(~byte);
    x = static_cast<std::uint8_t>(x - (x >> 1 & 0x55));
    x = static_cast<std::uint8_t>((x & 0x33) + (x >> 2 & 0x33));
    return static_cast<std::uint8_t>((x + (x >> 4)) & 0x0F);
  }
  // 1 if a number is at least a limit, else 0: written with minima, which compilers vectorise without widening.
  template <class Number>
  static constexpr Number reaches(Number number, Number limit) {
    const auto before = static_cast<Number>(limit - 1);
    const Number up_to = number < limit ? number : limit, below = number < before ? number : before;
    return static_cast<Number>(up_to - below);
  }
  // Classes of counts that reach at most the first `limits` limits.
  template <std::size_t limits>
  static const std::uint8_t* classes(const PaddedRow& counts, std::size_t n, PaddedRow& to) {
    fill(to.cells(), n, [from = counts.cells()](std::size_t k) {
      std::uint8_t c = 0;
      for (std::size_t i = 0; i < limits; ++i) c = static_cast<std::uint8_t>(c + reaches(from[k], kCountLimits[i]));
      return c;
    });
    return to.cells();
  }
  static constexpr std::uint16_t at_most_1(std::uint16_t x) { return x < 1 ? x : std::uint16_t{1}; }
  static constexpr std::uint8_t at_most_7(std::uint8_t x) { return x < 7 ? x : std::uint8_t{7}; }

  // Sums of one_ over nine cells, from four to the left to four to the right. eight_ then has the sums of eight.
  void sum(std::size_t n, PaddedRow& sums) {
    const std::uint8_t* const c = first(one_);
    std::uint8_t *const two = first(two_), *const four = first(four_), *const eight = first(eight_);
    const std::size_t all = n + 2 * kMargin;
    fill(two, all - 1, [=](std::size_t i) { return c[i] + c[i + 1]; });
    fill(four, all - 3, [=](std::size_t i) { return two[i] + two[i + 2]; });
    fill(eight, all - 7, [=](std::size_t i) { return four[i] + four[i + 4]; });
    fill(sums.cells(), n, [=](std::size_t k) { return eight[k + 4] + c[k + 12]; });
  }

  // Packs one bit of each of eight cells into a byte: from three cells to the left, the lowest bit, to four to the
  // right.
  void pack(const PaddedRow& bytes, int bit, std::size_t n, PaddedRow& packed) {
    const std::uint8_t* const b = bytes.cells() - 3;
    std::uint8_t *const one = first(one_), *const two = first(two_), *const four = first(four_);
    fill(one, n + 7, [=](std::size_t i) { return b[i] >> bit & 1; });
    fill(two, n + 6, [=](std::size_t i) { return one[i] | one[i + 1] << 1; });
    fill(four, n + 4, [=](std::size_t i) { return two[i] | two[i + 2] << 2; });
    fill(packed.cells(), n, [=](std::size_t i) { return four[i] | four[i + 4] << 4; });
  }

  // near_: octave class of the expected range; rough_: class of its differences from four neighbours, relative to the
  // range.
  void classify_expected(std::size_t n, const std::uint16_t* e) {
    if (e == nullptr) {
      fill(near_.cells() - 1, n + 2, [](std::size_t) { return 0; });
      fill(rough_.cells(), n, [](std::size_t) { return 0; });
      return;
    }
    const std::uint16_t* const begin = e - 1;
    fill(near_.cells() - 1, n + 2, [=](std::size_t i) {
      const std::uint16_t range = begin[i];
      std::uint16_t c = at_most_1(range);
      for (const int octave : {10, 11, 12, 13, 14, 15})
        c = static_cast<std::uint16_t>(c + at_most_1(static_cast<std::uint16_t>(range >> octave)));
      return c;
    });
    fill(rough_.cells(), n, [=](std::size_t k) {
      const std::uint16_t at = e[k], quarter = at >> 2, eighth = at >> 3;
      std::uint16_t apart = 0;
      for (const std::ptrdiff_t beside : {-2, -1, 1, 2}) {
        const std::uint16_t there = e[static_cast<std::ptrdiff_t>(k) + beside];
        const auto off = static_cast<std::uint16_t>(there > at ? there - at : at - there);
        const std::uint16_t most = there == 0 ? eighth : quarter;
        apart = static_cast<std::uint16_t>(apart + (off < most ? off : most));
      }
      std::uint16_t c = at_most_1(at);
      for (const int part : {1, 2, 3, 4, 5, 6}) {
        const auto limit = static_cast<std::uint16_t>(at >> part);
        c = static_cast<std::uint16_t>(
            c + at_most_1(apart > limit ? static_cast<std::uint16_t>(apart - limit) : std::uint16_t{0}));
      }
      return c;
    });
  }

  void number_gates(std::size_t n) {
    const std::uint8_t *const a1 = above_bits_.cells(), *const t1 = turn_bits_.cells();
    const std::uint8_t* const over = classes<8>(holes_above_, n, above_class_);
    classes<10>(holes_wide_, n, wide_class_);
    classes<7>(changed_, n, changed_class_);
    const std::uint8_t* const around = classes<10>(holes_here_, n, around_class_);
    classes<9>(holes_new_, n, places_class_);
    const std::uint8_t* const ever = classes<13>(holes_ever_, n, ever_class_);
    fill(gate.data(), n, [=](std::size_t k) {
      return at_most_7(ever[k]) | at_most_7(over[k]) << 3 | (a1[k] >> 3 & 1u) << 9 | (t1[k] >> 3 & 1u) << 10 |
             at_most_7(around[k]) << 11;
    });
  }

  // History bytes of the three rows above, with this frame, of the row below, and of the places above and below.
  PaddedRow above_{0}, above2_{0}, above3_{0}, below_{0}, place_above_{0}, place_below_{0};
  PaddedRow one_{0}, two_{0}, four_{0}, eight_{0};
  PaddedRow above_bits_{0}, above2_bits_{0}, above3_bits_{0}, turn_bits_{0}, turn2_bits_{0},
      turn3_bits_{0};  // eight cells of the rows above and of the last three turns
  // Counts of holes over nine cells: in the three rows above, also over 17 (wide); in four turns of this row and three
  // of the row below (here); in two turns of the places, and one of those above and below (new); in eight turns of them
  // (ever); a turn ago (about). And of cells in the two rows above that changed since the last turn.
  PaddedRow holes_above_{0}, holes_wide_{0}, holes_here_{0}, holes_new_{0}, holes_ever_{0}, about_{0}, changed_{0};
  PaddedRow above_class_{0}, wide_class_{0}, changed_class_{0}, around_class_{0}, places_class_{0},
      ever_class_{0};  // classes of these counts
  PaddedRow near_{0}, rough_{0};
  unsigned row_ = 0;
};

}  // namespace lidarcodec
