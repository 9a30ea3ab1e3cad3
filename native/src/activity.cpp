#include "activity.hpp"

#include <bit>
#include <string>

#include "error.hpp"

namespace lidarcodec {
namespace {

// The last four absolute differences and their sum, at most 4 x 32768.
class Activity {
 public:
  unsigned bits() const { return static_cast<unsigned>(std::bit_width(sum_)); }

  void push(std::uint16_t difference) {
    const std::uint32_t size = difference < 0x8000u ? difference : 0x10000u - difference;
    sum_ += size - last_[at_];
    last_[at_] = size;
    at_ = (at_ + 1u) & 3u;
  }

 private:
  std::array<std::uint32_t, 4> last_{};
  std::uint32_t sum_ = 0;
  unsigned at_ = 0;
};

void check_groups(const std::array<std::uint8_t, kActivities>& group_of) {
  for (std::size_t i = 0; i < kActivities; ++i)
    if (group_of[i] >= kActivities || (i > 0 && group_of[i] < group_of[i - 1]))
      throw Error(ErrorCode::Section, "groups of activities that do not follow each other");
}

}  // namespace

std::array<std::uint32_t, kActivities> count_activities(const std::uint16_t* values, std::size_t size) {
  std::array<std::uint32_t, kActivities> counts{};
  Activity activity;
  std::uint16_t before = 0;
  for (std::size_t i = 0; i < size; ++i) {
    ++counts[activity.bits()];
    activity.push(static_cast<std::uint16_t>(values[i] - before));
    before = values[i];
  }
  return counts;
}

std::vector<std::uint16_t> split_by_activity(const std::uint16_t* values, std::size_t size,
                                             const std::array<std::uint8_t, kActivities>& group_of) {
  check_groups(group_of);
  const auto activities = count_activities(values, size);
  std::array<std::size_t, kActivities + 1> next{};
  for (std::size_t i = 0; i < kActivities; ++i) next[group_of[i] + 1u] += activities[i];
  for (std::size_t g = 1; g <= kActivities; ++g) next[g] += next[g - 1];

  std::vector<std::uint16_t> differences(size);
  Activity activity;
  std::uint16_t before = 0;
  for (std::size_t i = 0; i < size; ++i) {
    const auto difference = static_cast<std::uint16_t>(values[i] - before);
    differences[next[group_of[activity.bits()]]++] = difference;
    activity.push(difference);
    before = values[i];
  }
  return differences;
}

std::vector<std::uint16_t> join_by_activity(const std::uint16_t* differences, std::size_t size,
                                            const std::array<std::uint8_t, kActivities>& group_of,
                                            const std::array<std::uint32_t, kActivities>& counts) {
  check_groups(group_of);
  std::array<std::size_t, kActivities> next{}, end{};
  std::size_t total = 0;
  for (std::size_t g = 0; g < kActivities; ++g) {
    next[g] = total;
    total += counts[g];
    end[g] = total;
  }
  if (total != size) throw Error(ErrorCode::Section, "groups that do not add up to the differences given");

  std::vector<std::uint16_t> values(size);
  Activity activity;
  std::uint16_t before = 0;
  for (std::size_t i = 0; i < size; ++i) {
    const std::size_t group = group_of[activity.bits()];
    if (next[group] == end[group])
      throw Error(ErrorCode::Section, "group " + std::to_string(group) + " of differences ran out at value " + std::to_string(i));
    const std::uint16_t difference = differences[next[group]++];
    before = static_cast<std::uint16_t>(before + difference);
    values[i] = before;
    activity.push(difference);
  }
  return values;
}

}  // namespace lidarcodec
