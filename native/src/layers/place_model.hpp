// The decisions that say where in its cells a return lies, and what they learn.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "bits/wide_coder.hpp"

namespace lidarcodec {

// 2 log2 of v + 2, nearly, from 0 for 0 and 1: two numbers for each power of two.
inline std::uint32_t size_class(std::uint64_t v) {
  const std::uint64_t y = v + 2;
  const auto top = static_cast<std::uint32_t>(std::bit_width(y)) - 1;
  const std::uint32_t twice = 2 * top + static_cast<std::uint32_t>(y >> (top - 1) & 1);
  return twice < 3 ? 0 : twice - 3;
}

// What is known of a return. Places are sixteenths of a range step from the value of the base, up if `up` is.
struct Known {
  std::int64_t predicted, left, above, between;  // between: the mean of the base's values to both sides
  std::uint32_t scale;                           // of errors of predictions, 0 to 23
  std::uint32_t left_trend;                      // 0 to 15
  std::uint32_t above_slope;                     // 0 to 7, 7: nothing is known above
  std::uint32_t sides;                           // 0 to 8: base to the left, to the right: less, equal, more
};

class PlaceModel {
 public:
  static constexpr int kContexts = 6;

  // cells: how many there are, odd; fine: range steps in each.
  PlaceModel(std::uint32_t cells, std::uint32_t fine)
      : count_(cells), fine_(fine), half_(8 * std::int64_t{cells} * fine) {
    for (std::uint32_t depth = 0; depth < kFirst.size(); ++depth)
      for (std::uint32_t other = 0; other < kPlaces; ++other)
        for (std::uint32_t place = 0; place < kPlaces; ++place) {
          const int from_middle = std::clamp(2 * static_cast<int>(place) - 21, -16, 16);  // halves of a place
          both_[index(depth, kPlaces, other, place)].odds = static_cast<std::int16_t>(from_middle * kFirst[depth]);
        }
    for (std::uint32_t width = 1; width < kMostTold; ++width)
      for (std::uint32_t upper = 1; upper < width; ++upper) share_[width][upper] = share_of(upper, width);
  }

  // The number of a cell, 0 to cells - 1. decide: of a probability, and the first cell of the upper ones, says whether
  // it is one of these, 0 or 1.
  template <class Decide>
  std::uint32_t code(const Known& known, const Decide& decide) {
    std::uint32_t low = 0, high = count_, node = 1;
    for (std::uint32_t depth = 0; high - low >= kTaught; ++depth) {
      const std::uint32_t width = high - low, middle = low + width / 2;
      const std::uint32_t at_depth = std::min(depth, kDepths - 1);
      const std::int64_t edge = 16 * std::int64_t{middle} * fine_ - half_, size = std::int64_t{width} * fine_;
      const std::uint32_t predicted = place(known.predicted - edge, size), left = place(known.left - edge, size);
      std::array<Cell*, kContexts> cells = {&both_[index(at_depth, kPlaces, left, predicted)]};
      int used = 1;
      if (width >= kAlone) {
        cells = {cells[0],
                 &scaled_[index(at_depth, kScales, known.scale, predicted)],
                 &lefts_[index(at_depth, kTrends, known.left_trend, left)],
                 &aboves_[index(at_depth, kSlopes, known.above_slope, place(known.above - edge, size))],
                 &betweens_[index(at_depth, kSides, known.sides, place(known.between - edge, size))],
                 &nodes_[std::min(node, kNodes - 1) * kSides + known.sides]};
        used = kContexts;
      }
      int sum = width < kMostTold ? share_[width][high - middle] : 0;
      for (int i = 0; i < used; ++i) sum = std::clamp(sum + cells[static_cast<std::size_t>(i)]->odds, -32768, 32767);
      const int p = probability(sum);
      const std::uint32_t bit = decide(static_cast<std::uint32_t>(p), middle);
      for (int i = 0; i < used; ++i) cells[static_cast<std::size_t>(i)]->learn(bit, p);
      (bit != 0 ? low : high) = middle;
      node = 2 * node + bit;
    }
    while (high - low > 1) {
      const std::uint32_t width = high - low, middle = low + width / 2;
      (decide(32768 * (high - middle) / width, middle) != 0 ? low : high) = middle;
    }
    return low;
  }

 private:
  struct Cell {
    std::int16_t odds = 0;  // as in bits/cells.hpp
    std::uint16_t count = 0;

    void learn(std::uint32_t bit, int p) {
      const int rate = count < 4 ? 1056 : count < 12 ? 704 : count < 40 ? 528 : 352;
      const int move = ((static_cast<int>(32767 * bit) - p) * rate + 32768) >> 16;
      odds = static_cast<std::int16_t>(std::clamp(odds + move, -32768, 32767));
      count = static_cast<std::uint16_t>(std::min(count + 1, 40));
    }
  };

  static constexpr std::uint32_t kDepths = 12, kPlaces = 22, kScales = 24, kTrends = 16, kSlopes = 8, kSides = 9;
  static constexpr std::uint32_t kNodes = 1024;
  static constexpr std::uint32_t kTaught = 5;     // fewer cells are equally likely
  static constexpr std::uint32_t kAlone = 7;      // fewer cells have one context
  static constexpr std::uint32_t kMostTold = 32;  // of fewer cells, the share of the upper ones is told beforehand
  static constexpr std::array<int, 4> kFirst = {450, 450, 270, 112};  // log odds of half a place, at each depth

  static std::size_t index(std::uint32_t depth, std::uint32_t others, std::uint32_t other, std::uint32_t place) {
    return (std::size_t{depth} * others + other) * kPlaces + place;
  }

  // Where something lies that is `apart` from the edge between two halves of cells: 11 places to either side.
  static std::uint32_t place(std::int64_t apart, std::int64_t size) {
    static constexpr auto kPlaceOf = [] {
      constexpr std::array<std::int64_t, 10> limits = {1, 2, 4, 6, 9, 13, 18, 24, 32, 48};
      std::array<std::uint8_t, 49> of{};
      for (std::int64_t far = 0; far < 49; ++far)
        for (const std::int64_t limit : limits) {
          std::uint8_t& places = of[static_cast<std::size_t>(far)];
          if (far >= limit) places = static_cast<std::uint8_t>(places + 1);
        }
      return of;
    }();
    const auto far = 2 * static_cast<std::uint32_t>(std::abs(apart)) / static_cast<std::uint32_t>(size);
    const std::uint32_t by = kPlaceOf[std::min(far, 48u)];
    return apart < 0 ? 10 - by : 11 + by;
  }

  static int probability(int sum) {
    const auto t = static_cast<std::uint32_t>(65534 - 2 * (sum < 0 ? -1 - sum : sum));
    const std::uint32_t square = (t * t) >> 16;
    const int rare = std::max(static_cast<int>((square * t) >> 18), 10);
    return sum < 0 ? rare : 32767 - rare;
  }

  // The log odds of `upper` of `width`: the sum whose probability is nearest from below.
  static std::int16_t share_of(std::uint32_t upper, std::uint32_t width) {
    const int wanted = static_cast<int>(32768 * upper / width);
    int low = -32768, high = 32767;
    while (low < high) {
      const int middle = (low + high + 1) >> 1;
      if (probability(middle) <= wanted)
        low = middle;
      else
        high = middle - 1;
    }
    return static_cast<std::int16_t>(low);
  }

  std::uint32_t count_, fine_;
  std::int64_t half_;  // of all cells, in sixteenths
  std::vector<Cell> both_ = std::vector<Cell>(std::size_t{kDepths} * kPlaces * kPlaces);
  std::vector<Cell> scaled_ = std::vector<Cell>(std::size_t{kDepths} * kScales * kPlaces);
  std::vector<Cell> lefts_ = std::vector<Cell>(std::size_t{kDepths} * kTrends * kPlaces);
  std::vector<Cell> aboves_ = std::vector<Cell>(std::size_t{kDepths} * kSlopes * kPlaces);
  std::vector<Cell> betweens_ = std::vector<Cell>(std::size_t{kDepths} * kSides * kPlaces);
  std::vector<Cell> nodes_ = std::vector<Cell>(std::size_t{kNodes} * kSides);
  std::array<std::array<std::int16_t, kMostTold>, kMostTold> share_{};
};

}  // namespace lidarcodec
