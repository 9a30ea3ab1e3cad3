// Gathers from rows of directions to rows of cells, and scatters back.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "motion/range_history.hpp"

namespace lidarcodec {

inline constexpr std::size_t kDirections = kSlots;  // directions of a row, equally spaced over a turn

// Gathers the directions of groups of adjacent cells. The offsets within a group are the same in all rows of a half,
// and mostly small, so that a vector shuffle can do a group.
class CellGroups {
 public:
  static constexpr std::size_t kGroup = 8, kWithin = 16;
  static constexpr std::uint64_t kSpread = ~std::uint64_t{0};  // a group whose offsets reach kWithin or more

  CellGroups() = default;
  // slots: the direction of each cell.
  explicit CellGroups(const std::vector<std::uint16_t>& slots) : of_(slots.size() / kGroup) {
    for (std::size_t g = 0; g < of_.size(); ++g) {
      const std::uint16_t* const slot = slots.data() + g * kGroup;
      for (std::size_t j = 0; j < kGroup && of_[g] != kSpread; ++j) {
        const std::uint64_t behind = (slot[j] + kDirections - slot[0]) % kDirections;
        of_[g] = behind < kWithin ? of_[g] | behind << (8 * j) : kSpread;
      }
    }
  }

  std::size_t groups() const { return of_.size(); }
  // The offsets of the cells of a group from its first one, a byte each.
  std::uint64_t operator[](std::size_t group) const { return of_[group]; }

 private:
  std::vector<std::uint64_t> of_;
};

// The inverse: the cells of groups of adjacent directions.
class DirectionGroups {
 public:
  static constexpr std::size_t kGroup = 16, kGroups = kDirections / kGroup;
  static constexpr std::uint32_t kNoCell = 0xFFFFFFFF;
  static constexpr std::size_t kRoom = kGroup;  // cells beyond the last one that may be read

  struct Group {
    std::array<std::uint8_t, kGroup> behind{};  // offset of the cell of each direction from `first`
    std::uint32_t first = kNoCell;              // kNoCell: a direction has no cell, or an offset reaches kGroup
  };

  // owner: of each direction the cell, or kNoCell.
  void begin(std::vector<std::uint32_t> cell_of) {
    cells_ = std::move(cell_of);
    groups_.resize(kGroups);
    for (std::size_t g = 0; g < kGroups; ++g) {
      const std::uint32_t* const cells = cells_.data() + g * kGroup;
      const auto [least, most] = std::minmax_element(cells, cells + kGroup);
      if (*most == kNoCell || *most - *least >= kGroup) continue;
      groups_[g].first = *least;
      for (std::size_t i = 0; i < kGroup; ++i) groups_[g].behind[i] = static_cast<std::uint8_t>(cells[i] - *least);
    }
  }

  const Group& operator[](std::size_t group) const { return groups_[group]; }
  std::uint32_t cell_of(std::size_t direction) const { return cells_[direction]; }

 private:
  std::vector<std::uint32_t> cells_;
  std::vector<Group> groups_;
};

// to[direction + shift] = values[cell of the direction], for directions with a cell. put_group: does a group with a
// valid `first`.
template <class PutGroup>
inline void put_groups(const std::uint8_t* values, const DirectionGroups& picks, std::size_t shift, std::uint8_t* to,
                       PutGroup put_group) {
  constexpr std::size_t kGroup = DirectionGroups::kGroup;
  for (std::size_t g = 0; g < DirectionGroups::kGroups; ++g) {
    const DirectionGroups::Group& group = picks[g];
    const std::size_t at = (g * kGroup + shift) % kDirections;
    if (group.first != DirectionGroups::kNoCell && at + kGroup <= kDirections) {
      put_group(values + group.first, group.behind.data(), to + at);
      continue;
    }
    for (std::size_t i = 0; i < kGroup; ++i) {
      const std::uint32_t cell_of = picks.cell_of(g * kGroup + i);
      if (cell_of != DirectionGroups::kNoCell) to[(at + i) % kDirections] = values[cell_of];
    }
  }
}

// to[j][i] = from[j][at[i]] for cells from `begin` to `end`.
template <std::size_t count>
void look_up_each(const std::array<const std::uint8_t*, count>& from, const std::uint16_t* at, std::size_t begin,
                  std::size_t end, const std::array<std::uint8_t*, count>& to) {
  for (std::size_t i = begin; i < end; ++i)
    for (std::size_t j = 0; j < count; ++j) to[j][i] = from[j][at[i]];
}

}  // namespace lidarcodec
