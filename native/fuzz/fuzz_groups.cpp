// libFuzzer: what was split by activity or by neighbour must come back, and groups from outside fit or are refused.
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "base/error.hpp"
#include "planes/neighbour.hpp"
#include "ranges/activity.hpp"

namespace lc = lidarcodec;

namespace {

constexpr std::size_t kHead = 64;

// Groups that follow each other, opened where the input has a set bit.
template <std::size_t N>
std::array<std::uint8_t, N> groups_from(const std::uint8_t* head) {
  std::array<std::uint8_t, N> groups{};
  for (std::size_t i = 1; i < N; ++i) {
    const unsigned opens = head[i / 8 % kHead] >> (i % 8) & 1u;
    groups[i] = static_cast<std::uint8_t>(groups[i - 1] + (groups[i - 1] < N - 1 ? opens : 0u));
  }
  return groups;
}

void activities(const std::uint8_t* head, const std::vector<std::uint16_t>& values) {
  const auto groups = groups_from<lc::kActivities>(head);
  const auto activities = lc::count_activities(values.data(), values.size());
  std::array<std::uint32_t, lc::kActivities> counts{};
  for (std::size_t i = 0; i < counts.size(); ++i) counts[groups[i]] += activities[i];
  const auto split = lc::split_by_activity(values.data(), values.size(), groups);
  if (lc::join_by_activity(split.data(), split.size(), groups, counts) != values) std::abort();
  // Counts, groups and differences that do not belong together.
  auto bent = groups;
  bent[head[40] % bent.size()] = head[41];
  std::rotate(counts.begin(), counts.begin() + head[42] % counts.size(), counts.end());
  counts[head[43] % counts.size()] ^= head[44];
  try {
    (void)lc::join_by_activity(values.data(), values.size(), bent, counts);
  } catch (const lc::Error&) {
  }
}

void neighbours(const std::uint8_t* head, const std::vector<std::uint8_t>& bytes) {
  auto groups = groups_from<256>(head);
  lc::NeighbourCounts counts{};
  std::uint8_t before = 0;
  for (const std::uint8_t byte : bytes) {
    ++counts[groups[before]];
    before = byte;
  }
  const auto split = lc::split_by_neighbour(bytes.data(), bytes.size(), groups);
  if (lc::join_by_neighbour(split.data(), split.size(), groups, counts) != bytes) std::abort();
  groups[head[45]] = head[46];
  std::rotate(counts.begin(), counts.begin() + head[47], counts.end());
  try {
    (void)lc::join_by_neighbour(bytes.data(), bytes.size(), groups, counts);
  } catch (const lc::Error&) {
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < kHead) return 0;
  const std::vector<std::uint8_t> bytes(data + kHead, data + size);
  std::vector<std::uint16_t> values(bytes.size() / 2);
  if (!values.empty()) std::memcpy(values.data(), bytes.data(), values.size() * 2);
  activities(data, values);
  neighbours(data, bytes);
  return 0;
}
