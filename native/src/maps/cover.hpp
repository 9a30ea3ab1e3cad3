// Which points of a map to keep: lazy greedy for a monotone submodular sum (Minoux 1978; Nemhauser, Wolsey and Fisher
// 1978: at least 1 - 1/e of the best).
#pragma once
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace lidarcodec {

// first, last: the rows that each point covers, from the first to the last one; group: the group of a point, of
// `groups`; enough: points beyond which a row gains nothing; spread: worth of the first point of a group, the n-th is
// worth 1 / n of it.
struct CoverProblem {
  std::span<const std::int32_t> first, last;
  std::span<const std::int32_t> group;
  std::size_t rows, groups;
  double enough, spread;
};

// The places of up to `most` points, in the order in which they were taken: those of the largest gain of
//     sum over poses of min(enough, worth of the taken points that it sees) + sum over groups of spread (1 + 1/2 +
//     ...).
// Raises Settings for poses and groups that are not there.
std::vector<std::int32_t> greedy_cover(const CoverProblem& problem, std::size_t most);

}  // namespace lidarcodec
