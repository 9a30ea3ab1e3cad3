#include "ranges/activity.hpp"

#include <bit>
#include <string>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

unsigned activity_of(std::uint32_t sum) {
  return 31u -
         static_cast<unsigned>(std::countl_zero(2u * sum + 1u));  // the bit width of the sum; the argument is never 0
}

// The last four absolute differences, at most 32768 each.
class Activity {
 public:
  unsigned bits() const { return activity_of(last_ + before_); }

  void push(std::uint16_t difference) {
    before_ = last_ + second_ + third_;
    third_ = second_;
    second_ = last_;
    last_ = difference < 0x8000u ? difference : 0x10000u - difference;
  }

 private:
  std::uint32_t last_ = 0, second_ = 0, third_ = 0;
  std::uint32_t before_ =
      0;  // sum of the three before the last one, computed early to shorten the chain of dependencies
};

// Differences and activities of values that are all known: the same, in loops that compilers vectorise.
struct Stream {
  std::vector<std::uint16_t> differences;
  std::vector<std::uint16_t> sizes;  // absolute values, of differences[i] at i + 4

  Stream(const std::uint16_t* values, std::size_t size) : differences(size), sizes(size + 4) {
    if (size != 0) differences[0] = values[0];
    for (std::size_t i = 1; i < size; ++i) differences[i] = static_cast<std::uint16_t>(values[i] - values[i - 1]);
    for (std::size_t i = 0; i < size; ++i) {
      const std::uint16_t up = differences[i], down = static_cast<std::uint16_t>(0u - up);
      sizes[i + 4] = up < down ? up : down;
    }
  }

  unsigned activity(std::size_t i) const {
    return activity_of(std::uint32_t{sizes[i]} + sizes[i + 1] + sizes[i + 2] + sizes[i + 3]);
  }
};

void check_groups(const std::array<std::uint8_t, kActivities>& group_of) {
  for (std::size_t i = 0; i < kActivities; ++i)
    if (group_of[i] >= kActivities || (i > 0 && group_of[i] < group_of[i - 1]))
      throw Error(ErrorCode::Section, "groups of activities are not in rising order");
}

}  // namespace

std::array<std::uint32_t, kActivities> count_activities(const std::uint16_t* values, std::size_t size) {
  // Four counts for each activity, used in turn: incrementing one counter in a row would wait for the last increment.
  std::array<std::array<std::uint32_t, kActivities>, 4> parts{};
  const Stream stream(values, size);
  for (std::size_t i = 0; i < size; ++i) ++parts[i & 3u][stream.activity(i)];
  std::array<std::uint32_t, kActivities> counts{};
  for (const auto& part : parts)
    for (std::size_t i = 0; i < kActivities; ++i) counts[i] += part[i];
  return counts;
}

std::vector<std::uint16_t> split_by_activity(const std::uint16_t* values, std::size_t size,
                                             const std::array<std::uint8_t, kActivities>& group_of) {
  check_groups(group_of);
  const Stream stream(values, size);
  std::vector<std::uint8_t> groups(size);
  std::array<std::array<std::size_t, kActivities>, 4> counts{};
  for (std::size_t i = 0; i < size; ++i) {
    groups[i] = group_of[stream.activity(i)];
    ++counts[i & 3u][groups[i]];
  }
  std::array<std::size_t, kActivities> next{};
  for (std::size_t g = 1; g < kActivities; ++g) {
    next[g] = next[g - 1];
    for (const auto& part : counts) next[g] += part[g - 1];
  }
  std::vector<std::uint16_t> sorted(size);
  for (std::size_t i = 0; i < size; ++i) sorted[next[groups[i]]++] = stream.differences[i];
  return sorted;
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
  if (total != size) throw Error(ErrorCode::Section, "the counts of groups do not add up to the differences");

  std::vector<std::uint16_t> values(size);
  Activity activity;
  std::uint16_t before = 0;
  for (std::size_t i = 0; i < size; ++i) {
    const std::size_t group = group_of[activity.bits()];
    if (next[group] == end[group])
      throw Error(ErrorCode::Section,
                  "group " + std::to_string(group) + " of differences ran out at value " + std::to_string(i));
    const std::uint16_t difference = differences[next[group]++];
    before = static_cast<std::uint16_t>(before + difference);
    values[i] = before;
    activity.push(difference);
  }
  return values;
}

}  // namespace lidarcodec
