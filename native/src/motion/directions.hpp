// The 2048 directions of a turn, the same in every frame. The direction of a cell is that of its beam.
//
// A reducer that may choose between the returns of a voxel prefers directions on a lattice: numbers that a high power
// of two divides. A keep mask on a lattice costs few bits, because the coder of keep masks has the same lattice in its
// contexts (docs/wire-format-keep.md).
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "motion/fixed_angle.hpp"

namespace lidarcodec {

inline constexpr std::uint32_t kDirections = 2048;
inline constexpr std::uint32_t kFinestDirection = 5;  // 1: every 16th direction, 5: every odd one; 0: every 32nd
inline constexpr std::uint32_t kSharedDirection = 6;  // of a cell that has the direction of the cell before it
inline constexpr std::uint32_t kDirectionLevels = 7;
inline constexpr std::uint32_t kFinestRow = 3;
inline constexpr std::uint32_t kRowLevels = 4;

// The rotation correction of a row, steps of 1e-8 rad, in directions.
constexpr std::uint32_t direction_offset(std::int32_t rotation) {
  return ((angle_of_table(rotation) + (1u << 20)) >> 21) % kDirections;
}

// Direction of a cell; azimuth: 0 to 35999, of its half of the column.
constexpr std::uint32_t direction_of(std::uint32_t azimuth, std::uint32_t offset) {
  return (azimuth * kDirections / kAzimuthStepsPerTurn + kDirections - offset) % kDirections;
}

// The coarsest lattice that a direction or a row lies on; 0 is the coarsest of all.
constexpr std::uint32_t direction_level(std::uint32_t direction) {
  return kFinestDirection - std::min<std::uint32_t>(static_cast<std::uint32_t>(std::countr_zero(direction | 32u)), 5u);
}
constexpr std::uint32_t row_level(std::size_t row) {
  return kFinestRow - static_cast<std::uint32_t>(std::countr_zero(static_cast<std::uint32_t>(row) | 8u));
}

// A set of directions, a bit each.
class DirectionSet {
 public:
  void add(std::uint32_t direction) { words_[direction / 64] |= std::uint64_t{1} << direction % 64; }
  void add(const DirectionSet& other) {
    for (std::size_t i = 0; i < words_.size(); ++i) words_[i] |= other.words_[i];
  }

  // Bits of `count` directions from `first` on, up to 63 of them; the turn wraps.
  std::uint64_t from(std::uint32_t first, std::uint32_t count) const {
    const std::uint32_t word = first / 64, place = first % 64;
    const std::uint64_t next = words_[(word + 1) % words_.size()];
    return (words_[word] >> place | next << 1 << (63 - place)) & ((std::uint64_t{1} << count) - 1);
  }

 private:
  std::array<std::uint64_t, kDirections / 64> words_{};
};

}  // namespace lidarcodec
