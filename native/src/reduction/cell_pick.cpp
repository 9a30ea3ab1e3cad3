#include "reduction/cell_pick.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

constexpr int kMostTries = 24;
constexpr std::int32_t kFarthest = 1 << 22;
constexpr std::uint64_t kFree = ~std::uint64_t{0};
constexpr std::uint64_t kGolden = 0x9E3779B97F4A7C15;  // 2^64 divided by the golden ratio: Knuth's multiplicative hash

// The points in the order of choice, and a hash table of the voxels that have one.
class Search {
 public:
  Search(const std::int32_t* xyz, const std::uint32_t* order, std::size_t count, std::size_t want)
      : most_(std::min(3 * want + 64, count + 1)), points_(3 * count), table_(std::bit_ceil(4 * most_), kFree) {
    for (std::size_t i = 0; i < count; ++i) {
      if (order[i] >= count) throw Error(ErrorCode::Section, "an order names a point that does not exist");
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const std::int32_t at = xyz[3 * std::size_t{order[i]} + axis];
        if (at >= kFarthest || at < -kFarthest) throw Error(ErrorCode::Section, "a point beyond 262 m");
        points_[3 * i + axis] = at;
      }
    }
    shift_ = 64 - std::countr_zero(table_.size());
    chosen_.reserve(most_);
  }

  // Chooses the first point of each voxel of that side. Gives the number of voxels, extrapolated if it is above
  // `most_`.
  double choose(std::int32_t side) {
    std::fill(table_.begin(), table_.end(), kFree);
    chosen_.clear();
    // p / side by a product: with 2^40 / side, rounded up, the border of a voxel moves by less than a step.
    const std::int64_t factor = ((std::int64_t{1} << 40) + side - 1) / side;
    const std::size_t count = points_.size() / 3, mask = table_.size() - 1;
    for (std::size_t i = 0; i < count; ++i) {
      std::uint64_t key = 0;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const std::int64_t cell = (points_[3 * i + axis] * factor) >> 40;
        key = key << 20 | (static_cast<std::uint64_t>(cell) & 0xFFFFFu);
      }
      std::size_t at = (key * kGolden) >> shift_;
      while (table_[at] != kFree && table_[at] != key) at = (at + 1) & mask;
      if (table_[at] == key) continue;
      table_[at] = key;
      chosen_.push_back(static_cast<std::uint32_t>(i));
      if (chosen_.size() == most_)
        return static_cast<double>(most_) * static_cast<double>(count) / static_cast<double>(i + 1);
    }
    return static_cast<double>(chosen_.size());
  }

  const std::vector<std::uint32_t>& chosen() const { return chosen_; }
  bool complete() const { return chosen_.size() < most_; }

 private:
  std::size_t most_;
  std::vector<std::int32_t> points_;
  std::vector<std::uint64_t> table_;
  std::vector<std::uint32_t> chosen_;
  int shift_ = 0;
};

// The number of voxels falls with about the power 1.6 of their side: side * ratio^0.625, from square roots, which are
// exact.
double stretched(double side, double ratio) { return side * std::sqrt(ratio) * std::sqrt(std::sqrt(std::sqrt(ratio))); }

}  // namespace

Picked pick_cells(const std::int32_t* xyz, const std::uint32_t* order, std::size_t count, std::size_t want,
                  std::int32_t side) {
  Picked picked;
  picked.side = std::clamp(side, kLeastSide, kMostSide);
  if (count <= want || want == 0) {
    if (want != 0) picked.places.assign(order, order + count);
    return picked;
  }
  Search search(xyz, order, count, want);
  const std::size_t enough = want + want / 50;
  const double aim = static_cast<double>(want + enough) / 2;
  std::int32_t small = kLeastSide - 1, large = kMostSide + 1;  // sides that give too many, and too few
  std::vector<std::uint32_t> most, least;                      // the best choice of too few, and of enough
  for (int i = 0; i < kMostTries; ++i) {
    const double cells = search.choose(picked.side);
    const std::size_t found = search.chosen().size();
    if (search.complete() && found >= want && (least.empty() || found < least.size())) least = search.chosen();
    if (found < want && found > most.size()) most = search.chosen();
    if (search.complete() && found >= want && found <= enough) break;
    (found < want ? large : small) = picked.side;
    if (large - small <= 1) break;  // all sides are tried
    double next = stretched(picked.side, cells / aim);
    if (!(next > small && next < large) || i > 4) next = std::sqrt(static_cast<double>(small) * large);
    if (i > 12) next = (static_cast<double>(small) + large) / 2;
    picked.side =
        std::clamp(static_cast<std::int32_t>(next), std::max(small + 1, kLeastSide), std::min(large - 1, kMostSide));
  }
  const std::vector<std::uint32_t>& best = least.empty() ? most : least;
  picked.places.reserve(best.size());
  for (const std::uint32_t i : best) picked.places.push_back(order[i]);
  return picked;
}

}  // namespace lidarcodec
