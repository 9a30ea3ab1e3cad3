// Rows of directions, looked up for the cells of a row.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "motion/range_history.hpp"

namespace lidarcodec {

inline constexpr std::size_t kPlaces = kSlots;  // directions of a row

// Cells in groups: what lies between them is the same in all rows of a half, and mostly little.
class CellPicks {
 public:
  static constexpr std::size_t kGroup = 8, kWithin = 16;
  static constexpr std::uint64_t kApart = ~std::uint64_t{0};  // of a group that is not within so many directions

  CellPicks() = default;
  // slots: of each cell its direction.
  explicit CellPicks(const std::vector<std::uint16_t>& slots) : of_(slots.size() / kGroup) {
    for (std::size_t g = 0; g < of_.size(); ++g) {
      const std::uint16_t* const slot = slots.data() + g * kGroup;
      for (std::size_t j = 0; j < kGroup && of_[g] != kApart; ++j) {
        const std::uint64_t behind = (slot[j] + kPlaces - slot[0]) % kPlaces;
        of_[g] = behind < kWithin ? of_[g] | behind << (8 * j) : kApart;
      }
    }
  }

  std::size_t groups() const { return of_.size(); }
  // How far each cell of a group lies behind its first one, a byte each.
  std::uint64_t operator[](std::size_t group) const { return of_[group]; }

 private:
  std::vector<std::uint64_t> of_;
};

// The other way: directions in groups, and the cells whose they are.
class DirectionPicks {
 public:
  static constexpr std::size_t kGroup = 16, kGroups = kPlaces / kGroup;
  static constexpr std::uint32_t kNobody = 0xFFFFFFFF;
  static constexpr std::size_t kRoom = kGroup;  // values of cells may be read so far beyond the last

  struct Group {
    std::array<std::uint8_t, kGroup> behind{};  // how far the cell of each direction lies behind `first`
    std::uint32_t first = kNobody;              // kNobody: one has no cell, or they are not within so many
  };

  // owner: of each direction the cell, or kNobody.
  void begin(std::vector<std::uint32_t> owner) {
    owner_ = std::move(owner);
    groups_.resize(kGroups);
    for (std::size_t g = 0; g < kGroups; ++g) {
      const std::uint32_t* const cells = owner_.data() + g * kGroup;
      const auto [least, most] = std::minmax_element(cells, cells + kGroup);
      if (*most == kNobody || *most - *least >= kGroup) continue;
      groups_[g].first = *least;
      for (std::size_t i = 0; i < kGroup; ++i) groups_[g].behind[i] = static_cast<std::uint8_t>(cells[i] - *least);
    }
  }

  const Group& operator[](std::size_t group) const { return groups_[group]; }
  std::uint32_t owner(std::size_t direction) const { return owner_[direction]; }

 private:
  std::vector<std::uint32_t> owner_;
  std::vector<Group> groups_;
};

// to[direction + shift] = values[its cell] for directions that have one. put_group: of a group whose cells lie together.
template <class PutGroup>
inline void put_groups(const std::uint8_t* values, const DirectionPicks& picks, std::size_t shift, std::uint8_t* to, PutGroup put_group) {
  constexpr std::size_t kGroup = DirectionPicks::kGroup;
  for (std::size_t g = 0; g < DirectionPicks::kGroups; ++g) {
    const DirectionPicks::Group& group = picks[g];
    const std::size_t at = (g * kGroup + shift) % kPlaces;
    if (group.first != DirectionPicks::kNobody && at + kGroup <= kPlaces) {
      put_group(values + group.first, group.behind.data(), to + at);
      continue;
    }
    for (std::size_t i = 0; i < kGroup; ++i) {
      const std::uint32_t owner = picks.owner(g * kGroup + i);
      if (owner != DirectionPicks::kNobody) to[(at + i) % kPlaces] = values[owner];
    }
  }
}

// to[j][i] = from[j][at[i]] for cells from `begin` to `end`.
template <std::size_t count>
void look_up_each(const std::array<const std::uint8_t*, count>& from, const std::uint16_t* at, std::size_t begin, std::size_t end,
                  const std::array<std::uint8_t*, count>& to) {
  for (std::size_t i = begin; i < end; ++i)
    for (std::size_t j = 0; j < count; ++j) to[j][i] = from[j][at[i]];
}

}  // namespace lidarcodec
