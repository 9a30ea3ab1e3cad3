// Numbers near an expected one: the leaf of a tree that the number falls into, then its place within the leaf.
//
// Leaves are counted in bins of 2^scale numbers, narrow where numbers are frequent:
//
//   leaf   0     1         2        3       4       5      6  7  8  9 10   11    12    13      14      15
//   bins  <-34 -34..-19 -18..-11 -10..-7 -6..-5 -4..-3 -2 -1  0  1  2  3..4  5..6  7..10  11..18  >18
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "images/decisions.hpp"

namespace lidarcodec {

inline constexpr std::size_t kLeaves = 16;
inline constexpr std::uint8_t kCentralLeaf = 8;

// First bin of each leaf, and the logarithm of the number of its bins.
inline constexpr std::array<std::int32_t, kLeaves> kFirstBin = {0, -34, -18, -10, -6, -4, -2, -1,
                                                                0, 1,   2,   3,   5,  7,  11, 19};
inline constexpr std::array<std::uint32_t, kLeaves> kLeafBits = {0, 4, 3, 2, 1, 1, 0, 0, 0, 0, 0, 1, 1, 2, 3, 0};
inline constexpr std::int32_t kLowestBin = -34, kEndBin = 19;
inline constexpr std::uint32_t kLastLeaf = kLeaves - 1;

inline constexpr auto kLeafOfBin = [] {
  std::array<std::uint8_t, kEndBin - kLowestBin> leaves{};
  for (std::uint8_t leaf = 1; leaf < kLastLeaf; ++leaf)
    for (std::int32_t i = 0; i < 1 << kLeafBits[leaf]; ++i)
      leaves[static_cast<std::size_t>(kFirstBin[leaf] + i - kLowestBin)] = leaf;
  return leaves;
}();

inline std::uint32_t leaf_of(std::int32_t bin) {
  if (bin < kLowestBin) return 0;
  return bin >= kEndBin ? kLastLeaf : kLeafOfBin[static_cast<std::size_t>(bin - kLowestBin)];
}

// Log odds of the nodes of the tree before anything is learned.
inline constexpr std::array<Odds, kLeaves> kFirstOdds = {0,     1826, 5499, -5665, 6104,  796,  -3728, -3351,
                                                         -4931, 2735, 2825, 2024,  -3972, 1449, 58,    -1768};

// Class of a distance in half bins: 0 to 12, 6 in the middle.
inline constexpr std::uint32_t kDistanceClasses = 13;
inline constexpr auto kDistanceClass = [] {
  std::array<std::uint8_t, 64> classes{};
  for (std::int32_t i = 0; i < 64; ++i) {
    const std::int32_t distance = i - 32, size = distance < 0 ? -distance : distance;
    const std::int32_t step = size <= 2 ? size : size <= 4 ? 3 : size <= 8 ? 4 : size <= 16 ? 5 : 6;
    classes[static_cast<std::size_t>(i)] = static_cast<std::uint8_t>(distance < 0 ? 6 - step : 6 + step);
  }
  return classes;
}();

inline std::uint32_t distance_class(std::int32_t distance, std::uint32_t scale) {
  return kDistanceClass[static_cast<std::size_t>(std::clamp((2 * distance) >> scale, -32, 31) + 32)];
}

// Numbers around one.
struct Near {
  std::int32_t left, above, right_above, left_above, second_left, second_above;

  std::int32_t average() const {
    return (2 * left + 2 * above + right_above + left_above + second_left + second_above + 4) / 8;
  }
  std::uint32_t slope() const {
    return static_cast<std::uint32_t>(std::abs(left - left_above) + std::abs(above - left_above) +
                                      std::abs(above - right_above));
  }
};

// Bins of 2^scale numbers; bin 0 begins with `start`.
struct Bins {
  std::int32_t start;
  std::uint32_t scale;
};

// The models of the numbers of one plane, but for the contexts of their leaves.
class NumberCoder {
 public:
  // Writes `value`, or reads one: from `least` to `most`. weights: of the contexts, null: all are one. leaf: set to the
  // one that it falls into. Raises Section.
  template <bool Quick, class Stream, std::size_t N>
  std::int32_t code(Stream& stream, std::int32_t value, const Bins& bins, const Near& near,
                    const std::array<Cells*, N>& contexts, std::int16_t rate, std::int32_t least, std::int32_t most,
                    std::uint32_t& leaf, Cells* weights) {
    const std::uint32_t want = Stream::kReads ? 0 : leaf_of((value - bins.start) >> bins.scale);
    leaf = weights != nullptr ? stream.template by_weighted<4>(want, contexts, weights, rate)
                              : stream.template by_cells<4>(want, contexts, rate);
    const std::int64_t result = leaf > 0 && leaf < kLastLeaf
                                    ? within_leaf<Quick>(stream, value, bins, near, leaf, rate)
                                    : beyond_leaves(stream, value, bins, near, leaf == kLastLeaf);
    if (result < least || result > most) throw Error(ErrorCode::Section, "a number of a plane beyond its limits");
    return static_cast<std::int32_t>(result);
  }

 private:
  static constexpr std::size_t kPlaces = 10;  // before a leaf, in each eighth of it, after it
  static constexpr std::size_t kScales = 17;

  template <bool Quick, class Stream>
  std::int32_t within_leaf(Stream& stream, std::int32_t value, const Bins& bins, const Near& near, std::uint32_t leaf,
                           std::int16_t rate) {
    std::int32_t first = bins.start + kFirstBin[leaf] * (1 << bins.scale);
    std::uint32_t bits = kLeafBits[leaf] + bins.scale;
    if (!Quick && kLeafBits[leaf] >= 2) {
      const bool eighths = bits > 2;
      bits -= eighths ? 3 : 2;
      const auto place = [&](std::int32_t at) {
        return static_cast<std::size_t>(std::clamp((at - first) >> bits, -1, 8) + 1);
      };
      const std::size_t of_leaf = (leaf * 2 + eighths) * kPlaces;
      const std::array<Cells*, 4> contexts = {&places_[0][of_leaf + place(near.above)],
                                              &places_[1][of_leaf + place(near.left)],
                                              &places_[2][of_leaf + place(near.right_above)],
                                              &places_[3][of_leaf + std::min<std::size_t>(bins.scale, kPlaces - 1)]};
      const std::uint32_t want = Stream::kReads ? 0 : static_cast<std::uint32_t>((value - first) >> bits);
      const std::uint32_t part = eighths ? stream.template by_cells<3>(want, contexts, rate)
                                         : stream.template by_cells<2>(want, contexts, rate);
      first += static_cast<std::int32_t>(part << bits);
    }
    return first + static_cast<std::int32_t>(
                       stream.plain(Stream::kReads ? 0 : static_cast<std::uint32_t>(value - first), bits));
  }

  // A number beyond the leaves, from the closest neighbour that is there too, or from the nearest number there.
  template <class Stream>
  std::int64_t beyond_leaves(Stream& stream, std::int32_t value, const Bins& bins, const Near& near, bool up) {
    const std::int32_t size = 1 << bins.scale;
    const std::int32_t limit = up ? bins.start + kEndBin * size : bins.start + kLowestBin * size - 1;
    for (const std::int32_t other :
         {near.above, near.left, near.right_above, near.left_above, near.second_left, near.second_above}) {
      if (up ? other < limit : other > limit) continue;
      const std::int32_t further = up ? value - other : other - value;
      const std::uint32_t nearer = stream.by_model(further < 0, nearer_[up]);
      const std::uint32_t size_of = static_cast<std::uint32_t>(std::abs(further)) - nearer;
      const auto distance =
          std::int64_t{from_neighbour_[up][nearer].code(stream, Stream::kReads ? 0 : size_of)} + nearer;
      return up != (nearer != 0) ? other + distance : other - distance;
    }
    const std::uint32_t low = bins.scale > 0 ? bins.scale - 1 : 0;
    const auto beyond = static_cast<std::uint32_t>(up ? value - limit : limit - value);
    std::int64_t distance = from_limit_[up].code(stream, Stream::kReads ? 0 : beyond >> low);
    distance = distance << low | stream.plain(beyond & ((1u << low) - 1), low);
    return up ? limit + distance : limit - distance;
  }

  std::array<std::vector<Cells>, 4> places_ = {
      std::vector<Cells>(2 * kLeaves * kPlaces), std::vector<Cells>(2 * kLeaves * kPlaces),
      std::vector<Cells>(2 * kLeaves * kPlaces), std::vector<Cells>(2 * kLeaves * kPlaces)};
  std::array<BitModel, 2> nearer_;
  std::array<std::array<FarNumbers, 2>, 2> from_neighbour_;
  std::array<FarNumbers, 2> from_limit_;
};

}  // namespace lidarcodec
