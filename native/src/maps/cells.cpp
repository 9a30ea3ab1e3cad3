#include "maps/cells.hpp"

#include <bit>

namespace lidarcodec {
namespace {

struct Node {
  std::uint64_t code;
  std::size_t begin, end;  // of the cells below it, where they are known
};

}  // namespace

// What is known around one child.
struct CellCoder::Around {
  unsigned depth;    // levels of cells below this child
  unsigned parents;  // seven nodes beside the parent, on the child's side
  unsigned far;      // three beside it on the other side
  unsigned lower;    // seven children with smaller coordinates
  unsigned mixed;    // six children with one coordinate larger and one smaller
  unsigned second;   // three children two steps below
  std::uint32_t height;
};

CellCoder::CellCoder()
    : models_{Models(kMapLevels * 256), Models(128 * 8 * 4 * 4),       Models(128 * 8 * 8 * 2),
              Models(128 * 128),        Models(kMapLevels * 1024 * 2), Models(64 * 8 * 8 * 8)} {}

template <class Bits>
bool CellCoder::child(Bits& bits, bool wanted, const Around& around, unsigned number, unsigned before) {
  const unsigned siblings = static_cast<unsigned>(std::popcount(before)) - 1;
  const unsigned last = around.depth == 0, near = std::min(around.depth, 3u);
  const unsigned faces = (around.lower & 1u) | (around.lower >> 0 & 2u) | (around.lower >> 1 & 4u);
  const std::array<BitModel*, kModels> models = {
      models_[0].at(around.depth * 256 + before),
      models_[1].at(((around.parents * 8 + number) * 4 + std::min(siblings, 3u)) * 4 + near),
      models_[2].at(((around.lower * 8 + around.far) * 8 + number) * 2 + last),
      models_[3].at(around.parents * 128 + around.lower),
      models_[4].at((around.depth * 1024 + std::min<std::uint32_t>(around.height, 1023)) * 2 + (siblings > 0)),
      models_[5].at(((around.mixed * 8 + faces) * 8 + number) * 8 + around.second),
  };
  return mixes_[near * 8 + number].code(bits, wanted, models);
}

template <class Bits>
void CellCoder::code(Bits& bits, std::vector<std::uint64_t>& cells, unsigned levels, std::size_t most) {
  std::vector<Node> nodes = {{0, 0, cells.size()}}, children;
  for (unsigned depth = levels; depth-- > 0;) {
    CellIndex parents(nodes.size()), known(2 * nodes.size());
    for (const Node& node : nodes) parents[node.code] = 0;
    const auto in = [](const CellIndex& index, const Cell& cell, unsigned bit) {
      // Coordinates below 0 wrap around, to cells that are never there.
      return cell[0] < (1u << 20) && cell[1] < (1u << 20) && cell[2] < (1u << 20) &&
                     index.find(morton_of(cell)) != CellIndex::kNone
                 ? 1u << bit
                 : 0u;
    };
    children.clear();
    for (const Node& node : nodes) {
      const Cell at = cell_of(node.code);
      unsigned beside = 0;  // 27 nodes around the parent
      for (unsigned i = 0; i < 27; ++i)
        if (i != 13) beside |= in(parents, {at[0] + i % 3 - 1, at[1] + i / 3 % 3 - 1, at[2] + i / 9 - 1}, i);
      unsigned before = 1;  // the children of this node so far, with a one in front
      std::size_t begin = node.begin;
      for (unsigned number = 0; number < 8; ++number) {
        const std::uint64_t code = node.code << 3 | number;
        std::size_t end = begin;
        if constexpr (!Bits::kReads)
          while (end < node.end && cells[end] >> (3 * depth) == code) ++end;
        bool there = true;
        if (number < 7 || before != 1u << 7) {
          Around around{depth, 0, 0, 0, 0, 0, 0};
          const std::array<int, 3> side = {number & 1 ? 1 : -1, number & 2 ? 1 : -1, number & 4 ? 1 : -1};
          for (unsigned i = 1; i < 8; ++i) {
            const int place = 13 + (i & 1 ? side[0] : 0) + (i & 2 ? 3 * side[1] : 0) + (i & 4 ? 9 * side[2] : 0);
            around.parents |= (beside >> place & 1u) << (i - 1);
          }
          constexpr std::array<int, 3> steps = {1, 3, 9};
          for (unsigned axis = 0; axis < 3; ++axis)
            around.far |= (beside >> (13 - side[axis] * steps[axis]) & 1u) << axis;
          const Cell child = cell_of(code);
          const auto [x, y, z] = child;
          for (unsigned i = 1; i < 8; ++i)
            around.lower |= in(known, {x - (i & 1), y - (i >> 1 & 1), z - (i >> 2 & 1)}, i - 1);
          around.mixed = in(known, {x + 1, y - 1, z}, 0) | in(known, {x - 1, y + 1, z}, 1) |
                         in(known, {x + 1, y, z - 1}, 2) | in(known, {x - 1, y, z + 1}, 3) |
                         in(known, {x, y + 1, z - 1}, 4) | in(known, {x, y - 1, z + 1}, 5);
          around.second = in(known, {x - 2, y, z}, 0) | in(known, {x, y - 2, z}, 1) | in(known, {x, y, z - 2}, 2);
          around.height = z;
          there = this->child(bits, end > begin, around, number, before);
        }
        before = before << 1 | (there ? 1u : 0u);
        if (!there) continue;
        if (children.size() == most) throw Error(ErrorCode::Section, "a tile has more cells than points");
        children.push_back({code, begin, end});
        known[code] = 0;
        begin = end;
      }
    }
    nodes.swap(children);
  }
  if constexpr (Bits::kReads) {
    cells.clear();
    for (const Node& node : nodes) cells.push_back(node.code);
  }
}

template void CellCoder::code(BitWriter&, std::vector<std::uint64_t>&, unsigned, std::size_t);
template void CellCoder::code(BitReader&, std::vector<std::uint64_t>&, unsigned, std::size_t);

}  // namespace lidarcodec
