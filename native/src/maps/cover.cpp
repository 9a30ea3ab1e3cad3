#include "maps/cover.hpp"

#include <algorithm>
#include <queue>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

struct Gain {
  double value;
  std::int32_t point;
  std::size_t found;  // how many points were taken when it was found

  bool operator<(const Gain& other) const { return value != other.value ? value < other.value : point > other.point; }
};

}  // namespace

std::vector<std::int32_t> greedy_cover(const CoverProblem& problem, std::size_t most) {
  const std::size_t count = problem.first.size();
  if (problem.last.size() != count || problem.group.size() != count)
    throw Error(ErrorCode::Settings, "rows and groups must be of the same points");
  for (std::size_t i = 0; i < count; ++i) {
    if (problem.first[i] < 0 || problem.last[i] < problem.first[i] ||
        static_cast<std::size_t>(problem.last[i]) >= problem.rows || problem.group[i] < 0 ||
        static_cast<std::size_t>(problem.group[i]) >= problem.groups)
      throw Error(ErrorCode::Settings, "a point covers rows, or is in a group, that is not there");
  }
  std::vector<double> seen(problem.rows);
  std::vector<std::size_t> in_group(problem.groups);
  const auto gain = [&](std::size_t point) {
    double sum = problem.spread / static_cast<double>(in_group[static_cast<std::size_t>(problem.group[point])] + 1);
    for (auto row = problem.first[point]; row <= problem.last[point]; ++row)
      sum += std::clamp(problem.enough - seen[static_cast<std::size_t>(row)], 0.0, 1.0);
    return sum;
  };
  std::vector<Gain> first;
  first.reserve(count);
  for (std::size_t i = 0; i < count; ++i) first.push_back({gain(i), static_cast<std::int32_t>(i), 0});
  std::priority_queue<Gain> queue(std::less<Gain>(), std::move(first));
  std::vector<std::int32_t> taken;
  while (taken.size() < most && !queue.empty()) {
    Gain best = queue.top();
    queue.pop();
    const auto point = static_cast<std::size_t>(best.point);
    if (best.found != taken.size()) {  // gains only fall, so one that is still the largest is the largest of all
      best.found = taken.size();
      best.value = gain(point);
      queue.push(best);
      continue;
    }
    taken.push_back(best.point);
    ++in_group[static_cast<std::size_t>(problem.group[point])];
    for (auto row = problem.first[point]; row <= problem.last[point]; ++row) seen[static_cast<std::size_t>(row)] += 1.0;
  }
  return taken;
}

}  // namespace lidarcodec
