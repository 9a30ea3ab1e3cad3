#include "planes/neighbour.hpp"

#include <string>

#include "base/error.hpp"

namespace lidarcodec {

std::vector<std::uint8_t> split_by_neighbour(const std::uint8_t* bytes, std::size_t size,
                                             const NeighbourGroups& group_of) {
  std::array<std::size_t, 257> next{};
  std::uint8_t before = 0;
  for (std::size_t i = 0; i < size; ++i) {
    ++next[group_of[before] + 1u];
    before = bytes[i];
  }
  for (std::size_t g = 1; g < next.size(); ++g) next[g] += next[g - 1];

  std::vector<std::uint8_t> sorted(size);
  before = 0;
  for (std::size_t i = 0; i < size; ++i) {
    sorted[next[group_of[before]]++] = bytes[i];
    before = bytes[i];
  }
  return sorted;
}

std::vector<std::uint8_t> join_by_neighbour(const std::uint8_t* sorted, std::size_t size,
                                            const NeighbourGroups& group_of, const NeighbourCounts& counts) {
  std::array<std::size_t, 256> next{}, end{};
  std::size_t total = 0;
  for (std::size_t g = 0; g < counts.size(); ++g) {
    next[g] = total;
    total += counts[g];
    end[g] = total;
  }
  if (total != size) throw Error(ErrorCode::Section, "groups that do not add up to the bytes given");

  std::vector<std::uint8_t> bytes(size);
  std::uint8_t before = 0;
  for (std::size_t i = 0; i < size; ++i) {
    const std::size_t group = group_of[before];
    if (next[group] == end[group])
      throw Error(ErrorCode::Section,
                  "group " + std::to_string(group) + " of bytes ran out at byte " + std::to_string(i));
    before = sorted[next[group]++];
    bytes[i] = before;
  }
  return bytes;
}

}  // namespace lidarcodec
