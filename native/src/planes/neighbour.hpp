// A permutation of bytes that groups them by the byte before them, so that a compressor finds similar ones together.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

using NeighbourGroups = std::array<std::uint8_t, 256>;   // group of each value of the byte before
using NeighbourCounts = std::array<std::uint32_t, 256>;  // bytes in each group

// The bytes of group 0, then those of group 1 and so on, each group in the original order. The byte before the first
// one is 0.
std::vector<std::uint8_t> split_by_neighbour(const std::uint8_t* bytes, std::size_t size,
                                             const NeighbourGroups& group_of);

// The inverse of split_by_neighbour. The counts must add up to `size`. Throws Error(Section) if a group runs out.
std::vector<std::uint8_t> join_by_neighbour(const std::uint8_t* sorted, std::size_t size,
                                            const NeighbourGroups& group_of, const NeighbourCounts& counts);

}  // namespace lidarcodec
