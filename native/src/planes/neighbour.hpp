// Bytes sorted into groups by the byte before them: a bright sign beside a bright sign, asphalt beside asphalt.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

using NeighbourGroups = std::array<std::uint8_t, 256>;   // group of each value of the byte before
using NeighbourCounts = std::array<std::uint32_t, 256>;  // bytes in each group

// The bytes of group 0 first, each group in its order. The byte before the first is 0.
std::vector<std::uint8_t> split_by_neighbour(const std::uint8_t* bytes, std::size_t size, const NeighbourGroups& group_of);

// What split_by_neighbour sorted. The counts must add up to `size`. Throws Error(Section) if a group runs out.
std::vector<std::uint8_t> join_by_neighbour(const std::uint8_t* sorted, std::size_t size, const NeighbourGroups& group_of,
                                            const NeighbourCounts& counts);

}  // namespace lidarcodec
