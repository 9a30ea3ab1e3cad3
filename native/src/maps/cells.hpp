// Which cells of a tile hold points: an octree, level by level, eight decisions a node.
//
// The contexts of a child are the nodes around its parent, which are all known, and the children around it that were
// coded before. The order is that of Morton (1966): a cell's neighbours with smaller coordinates always come first.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "base/error.hpp"
#include "bits/rangecoder.hpp"
#include "maps/mixing.hpp"

namespace lidarcodec {

inline constexpr unsigned kMapLevels = 16;

using Cell = std::array<std::uint32_t, 3>;

// Bits of x, y and z in turn, x lowest; coordinates of up to 21 bits.
inline std::uint64_t morton_of(const Cell& cell) {
  std::uint64_t code = 0;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::uint64_t v = cell[axis];
    v = (v | v << 32) & 0x1F00000000FFFF;
    v = (v | v << 16) & 0x1F0000FF0000FF;
    v = (v | v << 8) & 0x100F00F00F00F00F;
    v = (v | v << 4) & 0x10C30C30C30C30C3;
    v = (v | v << 2) & 0x1249249249249249;
    code |= v << axis;
  }
  return code;
}

inline Cell cell_of(std::uint64_t code) {
  Cell cell;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::uint64_t v = code >> axis & 0x1249249249249249;
    v = (v | v >> 2) & 0x10C30C30C30C30C3;
    v = (v | v >> 4) & 0x100F00F00F00F00F;
    v = (v | v >> 8) & 0x1F0000FF0000FF;
    v = (v | v >> 16) & 0x1F00000000FFFF;
    v = (v | v >> 32) & 0x1FFFFF;
    cell[axis] = static_cast<std::uint32_t>(v);
  }
  return cell;
}

// Places of cells by their Morton code: open addressing.
class CellIndex {
 public:
  static constexpr std::uint32_t kNone = 0xFFFFFFFFu;

  explicit CellIndex(std::size_t most) {
    std::size_t size = 16;
    while (size < 2 * most) size *= 2;
    keys_.assign(size, kEmpty);
    values_.resize(size);
  }
  std::uint32_t find(std::uint64_t key) const {
    for (std::size_t at = hash(key);; at = (at + 1) & (keys_.size() - 1)) {
      if (keys_[at] == key) return values_[at];
      if (keys_[at] == kEmpty) return kNone;
    }
  }
  // The value of a key, to be set; kNone where the key is new.
  std::uint32_t& operator[](std::uint64_t key) {
    if (2 * (used_ + 1) > keys_.size()) grow();
    std::size_t at = hash(key);
    while (keys_[at] != key && keys_[at] != kEmpty) at = (at + 1) & (keys_.size() - 1);
    if (keys_[at] == kEmpty) {
      keys_[at] = key;
      values_[at] = kNone;
      ++used_;
    }
    return values_[at];
  }

 private:
  static constexpr std::uint64_t kEmpty = ~std::uint64_t{0};

  std::size_t hash(std::uint64_t key) const { return (key * 0x9E3779B97F4A7C15u) >> 20 & (keys_.size() - 1); }
  void grow() {
    CellIndex larger(keys_.size());
    for (std::size_t i = 0; i < keys_.size(); ++i)
      if (keys_[i] != kEmpty) larger[keys_[i]] = values_[i];
    *this = std::move(larger);
  }

  std::vector<std::uint64_t> keys_;
  std::vector<std::uint32_t> values_;
  std::size_t used_ = 0;
};

class CellCoder {
 public:
  CellCoder();

  // Morton codes of cells, increasing; read where `Bits` reads. Raises Section for more than `most` cells.
  template <class Bits>
  void code(Bits& bits, std::vector<std::uint64_t>& cells, unsigned levels, std::size_t most);

 private:
  static constexpr std::size_t kModels = 6;

  struct Around;
  template <class Bits>
  bool child(Bits& bits, bool wanted, const Around& around, unsigned number, unsigned before);

  std::array<Models, kModels> models_;
  std::array<Mix<kModels>, 8 * 4> mixes_;
};

}  // namespace lidarcodec
