#include "ranges/huffman.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

namespace lidarcodec {

namespace {

// Depth of each leaf of the Huffman tree. Leaf kSymbols reserves the code of all ones.
std::array<std::size_t, kSymbols + 1> depths(const std::array<std::uint32_t, kSymbols>& occurs) {
  std::array<std::uint64_t, kSymbols + 1> weight{};
  std::copy(occurs.begin(), occurs.end(), weight.begin());
  weight[kSymbols] = 1;
  std::array<std::size_t, kSymbols + 1> root, depth{};
  std::iota(root.begin(), root.end(), std::size_t{0});
  for (;;) {
    std::size_t least = kSymbols + 1, second = kSymbols + 1;
    for (std::size_t i = 0; i <= kSymbols;
         ++i) {  // of equal weights the later symbol gets deeper, and the reserved leaf deepest
      if (!weight[i]) continue;
      if (least > kSymbols || weight[i] <= weight[least]) {
        second = least;
        least = i;
      } else if (second > kSymbols || weight[i] <= weight[second]) {
        second = i;
      }
    }
    if (second > kSymbols) return depth;
    weight[second] += weight[least];
    weight[least] = 0;
    for (std::size_t i = 0; i <= kSymbols; ++i) {
      if (root[i] != least && root[i] != second) continue;
      root[i] = second;
      ++depth[i];
    }
  }
}

}  // namespace

HuffmanTable best_table(const std::array<std::uint32_t, kSymbols>& occurs) {
  const auto depth = depths(occurs);
  std::array<std::size_t, kSymbols + 2> count{};
  for (std::size_t d : depth)
    if (d) ++count[d];
  for (std::size_t length = count.size() - 1; length > kMaxCodeBits; --length) {
    while (count[length]) {  // limits the length (T.81, figure K.3): one leaf of a pair moves up to its parent, the
                             // other pairs with a shorter code
      std::size_t shorter = length - 2;
      while (!count[shorter]) --shorter;
      count[length] -= 2;
      ++count[length - 1];
      count[shorter + 1] += 2;
      --count[shorter];
    }
  }
  std::size_t longest = kMaxCodeBits;
  while (longest && !count[longest]) --longest;
  --count[longest];  // the code of all ones stays unused

  HuffmanTable table;
  for (std::size_t i = 0; i < kSymbols; ++i)
    if (depth[i]) table.symbols.push_back(static_cast<std::uint8_t>(i));
  std::stable_sort(table.symbols.begin(), table.symbols.end(),
                   [&](std::uint8_t a, std::uint8_t b) { return depth[a] < depth[b]; });
  std::size_t at = 0;
  std::uint32_t code = 0;
  for (std::size_t length = 1; length <= kMaxCodeBits; ++length, code <<= 1) {
    table.count[length] = static_cast<std::uint8_t>(count[length]);
    for (std::size_t i = 0; i < count[length]; ++i, ++at, ++code) {
      table.code[table.symbols[at]] = static_cast<std::uint16_t>(code);
      table.bits[table.symbols[at]] = static_cast<std::uint8_t>(length);
    }
  }
  return table;
}

}  // namespace lidarcodec
