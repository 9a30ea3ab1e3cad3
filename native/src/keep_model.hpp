// What is likely of a cell of a keep mask: models, their contexts, and how they are weighed. docs/wire-format-keep.md.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "bitmodel.hpp"
#include "directions.hpp"

namespace lidarcodec {

inline constexpr std::size_t kKeepModels = 4;

// Weighs the log odds of several models; the weights follow the error four times as fast as those of `Mixer`: a mask has
// few cells that are kept, and each message begins anew.
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
    return std::clamp<std::uint32_t>(mixed_, kSurest, 65536u - kSurest);
  }

  void update(bool bit) {
    const std::int32_t error = (bit ? 65536 : 0) - static_cast<std::int32_t>(mixed_);
    for (std::size_t i = 0; i < kKeepModels; ++i)
      weights_[i] = std::clamp(weights_[i] + ((error * inputs_[i] + 0x2000) >> 14), -kHeaviest, kHeaviest);
  }

 private:
  static constexpr std::int32_t kHeaviest = 1 << 20;  // 16.0
  std::array<std::int32_t, kKeepModels> weights_{}, inputs_{};
  std::uint32_t mixed_ = 0;
};

// Cells since the last kept one, in classes.
inline constexpr std::array<std::uint8_t, 13> kGapLimits = {1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 100};
inline constexpr std::uint32_t kGapClasses = 14;
inline constexpr std::uint32_t kLongestGap = 101;
inline constexpr auto kGapClass = [] {
  std::array<std::uint8_t, kLongestGap + 1> classes{};
  for (std::uint32_t gap = 0; gap <= kLongestGap; ++gap)
    for (const std::uint8_t limit : kGapLimits) classes[gap] = static_cast<std::uint8_t>(classes[gap] + (gap > limit));
  return classes;
}();

// Rows since a direction was last kept, in classes; and how many directions around were lately.
constexpr std::uint32_t age_class(std::uint32_t rows) { return rows <= 1 ? 0 : rows <= 2 ? 1 : rows <= 4 ? 2 : rows <= 8 ? 3 : 4; }
constexpr std::uint32_t crowd_class(std::uint32_t count) {
  return count < 3 ? count : count < 5 ? 3 : count < 9 ? 4 : count < 16 ? 5 : 6;
}

// Where a context begins, by the level of its direction.
inline constexpr std::array<std::uint32_t, kDirectionLevels> kKeepPrior = {20000, 12000, 8500, 6000, 3600, 1800, 1200};

// Of each direction, what the rows above say of it.
class RowsAbove {
 public:
  RowsAbove() {
    age_.fill(kOldest);
    look();
  }

  std::uint32_t near(std::uint32_t direction) const { return near_[direction]; }    // age_class, two directions each way
  std::uint32_t wide(std::uint32_t direction) const { return wide_[direction]; }    // age_class, eight each way
  std::uint32_t crowd(std::uint32_t direction) const { return crowd_[direction]; }  // crowd_class * 6 + finest level

  void keep(std::uint32_t direction) { kept_[direction] = true; }

  // The row is over.
  void next() {
    for (std::size_t i = 0; i < kDirections; ++i) {
      age_[i] = kept_[i] ? std::uint8_t{1} : static_cast<std::uint8_t>(std::min(age_[i] + 1, int{kOldest}));
      kept_[i] = false;
    }
    look();
  }

 private:
  static constexpr std::uint8_t kOldest = 63, kLately = 3;
  static constexpr std::size_t kAround = 16;

  void look() {
    // The turn with both its ends repeated, so that windows need not wrap.
    std::array<std::uint8_t, kDirections + 2 * kAround> age, level;
    for (std::size_t i = 0; i < age.size(); ++i) {
      const auto direction = static_cast<std::uint32_t>((i + kDirections - kAround) % kDirections);
      age[i] = age_[direction];
      level[i] = age[i] <= kLately ? static_cast<std::uint8_t>(direction_level(direction)) : std::uint8_t{0};
    }
    std::array<std::uint8_t, kDirections> two, eight, finest;
    for (std::size_t i = 0; i < kDirections; ++i) two[i] = eight[i] = kOldest;
    finest.fill(0);
    for (std::size_t d = 0; d <= 2 * kAround; ++d) {
      for (std::size_t i = 0; i < kDirections; ++i) finest[i] = std::max(finest[i], level[i + d]);
      if (d >= kAround - 8 && d <= kAround + 8)
        for (std::size_t i = 0; i < kDirections; ++i) eight[i] = std::min(eight[i], age[i + d]);
      if (d >= kAround - 2 && d <= kAround + 2)
        for (std::size_t i = 0; i < kDirections; ++i) two[i] = std::min(two[i], age[i + d]);
    }
    std::uint32_t lately = 0;
    for (std::size_t d = 0; d < 2 * kAround; ++d) lately += age[d] <= kLately;
    for (std::size_t i = 0; i < kDirections; ++i) {
      lately += age[i + 2 * kAround] <= kLately;
      near_[i] = static_cast<std::uint8_t>(age_class(two[i]));
      wide_[i] = static_cast<std::uint8_t>(age_class(eight[i]));
      crowd_[i] = static_cast<std::uint8_t>(crowd_class(lately) * 6 + finest[i]);
      lately -= age[i] <= kLately;
    }
  }

  std::array<std::uint8_t, kDirections> age_{}, near_{}, wide_{}, crowd_{};
  std::array<bool, kDirections> kept_{};
};

// A table of models, one for each level of direction and whatever else a context holds.
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
