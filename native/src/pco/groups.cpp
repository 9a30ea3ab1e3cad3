#include "pco/groups.hpp"

#include <array>
#include <bit>
#include <string>

#include "pco/pco.hpp"
#include "ranges/activity.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kEntryBytes = 5;  // first activity u8, returns u32

struct Groups {
  std::size_t count = 0, bytes = 0;
  std::array<std::uint8_t, kActivities> group_of{};
  std::array<std::uint32_t, kActivities> returns{};
};

Groups read_groups(const std::uint8_t* data, std::size_t size, std::size_t returns) {
  Groups groups;
  groups.count = size > 0 ? data[0] : 0;
  groups.bytes = 1 + kEntryBytes * groups.count;
  if (groups.count < 1 || groups.count > kActivities || size < groups.bytes)
    throw Error(ErrorCode::Section, "a range section with " + std::to_string(groups.count) + " groups in " +
                                        std::to_string(size) + " bytes");
  std::uint64_t sum = 0;
  std::array<bool, kActivities> opens{};
  int before = -1;
  for (std::size_t g = 0; g < groups.count; ++g) {
    const std::uint8_t* const entry = data + 1 + kEntryBytes * g;
    if (entry[0] <= before || entry[0] >= kActivities || (g == 0 && entry[0] != 0))
      throw Error(ErrorCode::Section, "a group of activities that begins at " + std::to_string(entry[0]),
                  1 + kEntryBytes * g);
    before = entry[0];
    opens[entry[0]] = true;
    for (int i = 3; i >= 0; --i) groups.returns[g] = groups.returns[g] << 8 | entry[1 + i];
    sum += groups.returns[g];
  }
  if (sum != returns)
    throw Error(ErrorCode::Section, std::to_string(sum) + " differences for " + std::to_string(returns) + " returns");
  std::uint8_t group = 0;
  for (std::size_t activity = 1; activity < kActivities; ++activity)
    groups.group_of[activity] = group = static_cast<std::uint8_t>(group + opens[activity]);
  return groups;
}

}  // namespace

std::vector<std::uint16_t> decode_pco_groups(const std::uint8_t* data, std::size_t size, std::size_t returns) {
  const Groups groups = read_groups(data, size, returns);
  PcoReader pco(data + groups.bytes, size - groups.bytes);
  std::vector<std::int16_t> differences(returns);
  std::size_t done = 0;
  for (std::size_t g = 0; g < groups.count; done += groups.returns[g++])
    pco.read_chunk(differences.data() + done, groups.returns[g]);
  if (const std::size_t read = groups.bytes + pco.bytes_read(); read != size)
    throw Error(ErrorCode::Section, std::to_string(size - read) + " bytes after the last group of ranges", read);
  return join_by_activity(reinterpret_cast<const std::uint16_t*>(differences.data()), returns, groups.group_of,
                          groups.returns);
}

}  // namespace lidarcodec
