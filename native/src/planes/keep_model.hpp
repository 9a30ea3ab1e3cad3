// Models of the cells of a keep mask, their contexts, and their logistic mixing. docs/wire-format-keep.md has the
// format.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "bits/bitmodel.hpp"
#include "motion/directions.hpp"

namespace lidarcodec {

inline constexpr std::size_t kKeepModels = 4;

// Logistic mixing of several models (Mahoney 2005). The learning rate is four times that of `Mixer`: a mask has few
// kept cells, and each message begins with new weights.
class KeepMixer {
 public:
  KeepMixer() { weights_.fill(26214); }  // 0.4

  std::uint32_t mix(const std::array<BitModel*, kKeepModels>& models) {
    std::int64_t sum = 0;
    for (std::size_t i = 0; i < kKeepModels; ++i) {
      inputs_[i] = kStretch[models[i]->raw() >> 20];
      sum += static_cast<std::int64_t>(weights_[i]) * inputs_[i];
    }
    mixed_ = kSquash[static_cast<std::size_t>(std::clamp<std::int64_t>(sum >> 16, -2048, 2047) + 2048)];
    return std::clamp<std::uint32_t>(mixed_, kMinProbability, 65536u - kMinProbability);
  }

  void update(bool bit) {
    const std::int32_t error = (bit ? 65536 : 0) - static_cast<std::int32_t>(mixed_);
    for (std::size_t i = 0; i < kKeepModels; ++i)
      weights_[i] = std::clamp(weights_[i] + ((error * inputs_[i] + 0x2000) >> 14), -kMaxWeight, kMaxWeight);
  }

 private:
  static constexpr std::int32_t kMaxWeight = 1 << 20;  // 16.0
  std::array<std::int32_t, kKeepModels> weights_{}, inputs_{};
  std::uint32_t mixed_ = 0;
};

// Classes of the number of cells since the last kept one.
inline constexpr std::array<std::uint8_t, 13> kGapLimits = {1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 100};
inline constexpr std::uint32_t kGapClasses = 14;
inline constexpr std::uint32_t kLongestGap = 101;
inline constexpr auto kGapClass = [] {
  std::array<std::uint8_t, kLongestGap + 1> classes{};
  for (std::uint32_t gap = 0; gap <= kLongestGap; ++gap)
    for (const std::uint8_t limit : kGapLimits) classes[gap] = static_cast<std::uint8_t>(classes[gap] + (gap > limit));
  return classes;
}();

// Classes of the number of rows since a direction was last kept, by these limits, and of the number of directions kept
// nearby.
inline constexpr std::array<std::uint8_t, 4> kAgeLimits = {1, 2, 4, 8};
constexpr std::uint32_t crowd_class(std::uint32_t count) {
  return count < 3 ? count : count < 5 ? 3 : count < 9 ? 4 : count < 16 ? 5 : 6;
}

// The first probability of a context, of 65536, by the level of its direction.
inline constexpr std::array<std::uint32_t, kDirectionLevels> kKeepPrior = {20000, 12000, 8500, 6000, 3600, 1800, 1200};

// What the rows above kept, by direction.
class RowsAbove {
 public:
  std::uint32_t near(std::uint32_t direction) const { return age_class(direction, 2); }
  std::uint32_t wide(std::uint32_t direction) const { return age_class(direction, 8); }

  // crowd_class * 6 + finest level of the directions up to 16 away that the last three rows kept.
  std::uint32_t crowd(std::uint32_t direction) const {
    const std::uint32_t first = (direction + kDirections - 16) % kDirections;
    const std::uint64_t around = lately_.from(first, 33);
    std::uint32_t finest = kFinestDirection;
    while (finest > 0 && (around & std::rotr(kOfLevel[finest], static_cast<int>(first % 64))) == 0) --finest;
    return crowd_class(static_cast<std::uint32_t>(std::popcount(around))) * 6 + finest;
  }

  void keep(std::uint32_t direction) { kept_[0].add(direction); }

  // Ends the row.
  void next() {
    DirectionSet within;
    for (std::size_t row = 0, limit = 0; row < kept_.size(); ++row) {
      within.add(kept_[row]);
      if (row + 1 == kLately) lately_ = within;
      if (row + 1 == kAgeLimits[limit]) within_[limit++] = within;
    }
    std::copy_backward(kept_.begin(), kept_.end() - 1, kept_.end());
    kept_[0] = {};
  }

 private:
  static constexpr std::size_t kLately = 3;
  // The directions of each level among the first 64, a bit each.
  static constexpr auto kOfLevel = [] {
    std::array<std::uint64_t, kFinestDirection + 1> of{};
    for (std::uint32_t direction = 0; direction < 64; ++direction)
      of[direction_level(direction)] |= std::uint64_t{1} << direction;
    return of;
  }();

  // The class of the number of rows since a direction up to `reach` away was kept.
  std::uint32_t age_class(std::uint32_t direction, std::uint32_t reach) const {
    const std::uint32_t first = (direction + kDirections - reach) % kDirections;
    std::uint32_t age = 0;
    while (age < kAgeLimits.size() && within_[age].from(first, 2 * reach + 1) == 0) ++age;
    return age;
  }

  std::array<DirectionSet, kAgeLimits.back()> kept_;    // kept by this row, by the one above it, and so on
  std::array<DirectionSet, kAgeLimits.size()> within_;  // kept by as many rows above as the limit
  DirectionSet lately_;
};

// Models by level of direction and by a context.
template <std::size_t PerLevel>
class KeepTable {
 public:
  KeepTable() {
    for (std::size_t level = 0; level < kDirectionLevels; ++level)
      for (std::size_t i = 0; i < PerLevel; ++i) models_[level * PerLevel + i] = BitModel(kKeepPrior[level]);
  }
  BitModel& of(std::size_t level, std::size_t context) { return models_[level * PerLevel + context]; }

 private:
  std::array<BitModel, kDirectionLevels * PerLevel> models_;
};

struct KeepModels {
  KeepTable<kRowLevels * kGapClasses> gap;
  KeepTable<kRowLevels * 42> crowd;
  KeepTable<8 * kGapClasses> last;
  KeepTable<kRowLevels * 25> above;   // without an earlier mask
  KeepTable<kRowLevels * 8> earlier;  // with one
  std::array<KeepMixer, kDirectionLevels> mixers;
};

}  // namespace lidarcodec
