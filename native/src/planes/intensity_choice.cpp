#include "planes/intensity_choice.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <optional>

#include "base/error.hpp"
#include "mask/rows.hpp"
#include "planes/intensity_costs.hpp"

namespace lidarcodec {
namespace {

using Counts = std::array<std::size_t, 256>;
using Values = std::vector<std::uint8_t>;

constexpr std::size_t kSampledReturns = 16384;  // returns whose rows give the costs of transitions
constexpr int kRounds = 4;                      // of estimating them
constexpr std::size_t kMaxLevels = 64;  // with more levels each return gets the nearest one: a choice would save little

// Levels for a histogram by the algorithm of Lloyd (1982) and Max (1960): each is the mean of the intensities that are
// nearest to it. They begin evenly spaced. error: 16 times the mean squared error.
struct LloydMaxLevels {
  Values value;
  Cost error = 0;

  LloydMaxLevels(const Counts& counts, std::size_t levels) {
    Values used;
    for (std::size_t x = 0; x < counts.size(); ++x)
      if (counts[x] != 0) used.push_back(static_cast<std::uint8_t>(x));
    value = used;
    if (used.size() <= levels) return;
    std::vector<std::int64_t> at16(levels);
    const std::int64_t low = used.front(), high = used.back();
    for (std::size_t s = 0; s < levels; ++s)
      at16[s] = 16 * low + 16 * (high - low) * static_cast<std::int64_t>(s) / static_cast<std::int64_t>(levels - 1);
    for (int round = levels > kMaxLevels ? 6 : 24; round > 0; --round) {
      std::vector<std::size_t> sum(at16.size()), count(at16.size());
      std::size_t s = 0;
      for (const std::uint8_t x : used) {
        while (s + 1 < at16.size() && std::abs(16 * x - at16[s + 1]) < std::abs(16 * x - at16[s])) ++s;
        sum[s] += x * counts[x];
        count[s] += counts[x];
      }
      std::size_t kept = 0;
      for (s = 0; s < at16.size(); ++s)
        if (count[s] != 0) at16[kept++] = static_cast<std::int64_t>((16 * sum[s] + count[s] / 2) / count[s]);
      at16.resize(kept);
    }
    value.clear();
    for (const std::int64_t at : at16) value.push_back(static_cast<std::uint8_t>((at + 8) / 16));
    value.erase(std::unique(value.begin(), value.end()), value.end());

    const Candidates candidates(value);
    std::uint64_t total = 0, errors = 0;
    for (const std::uint8_t x : used) {
      const Candidates::Choices& choices = candidates.of(x);
      total += counts[x];
      errors += counts[x] * static_cast<std::uint64_t>(*std::min_element(choices.error.begin(), choices.error.end()));
    }
    error = static_cast<Cost>(errors / total);
  }
};

// The price of a bit, in proportion to the least error with so many levels. It is higher for few levels: neighbours are
// then equal except for noise, and small errors save many bits. With many levels most bits are noise.
Lambda lambda_for(const LloydMaxLevels& lloyd_max) {
  const std::size_t levels = std::max<std::size_t>(lloyd_max.value.size(), 10);
  return {static_cast<Cost>(std::int64_t{48} * lloyd_max.error / static_cast<std::int64_t>(levels))};
}

// The number and the mean of each level's returns.
class Centroids {
 public:
  void count(std::size_t level, std::uint8_t intensity) {
    ++returns_[level];
    sum_[level] += intensity;
  }

  // Moves each level to the mean of its returns. Levels stay distinct and rising.
  void move(Values& value) const {
    for (std::size_t s = 0; s < value.size(); ++s) {
      if (returns_[s] == 0) continue;
      const std::size_t mean = (sum_[s] + returns_[s] / 2) / returns_[s];
      const std::size_t low = s == 0 ? 0 : value[s - 1] + 1u, high = s + 1 == value.size() ? 255 : value[s + 1] - 1u;
      value[s] = static_cast<std::uint8_t>(std::clamp(mean, low, high));
    }
  }

 private:
  Counts returns_{}, sum_{};
};

// Calls act(intensity, index into an image) for the returns of a row.
template <class Act>
void for_each_return(const MaskLayout& layout, const ClosedRows& returned, std::size_t width, std::size_t row,
                     const Act& act) {
  const std::vector<std::uint32_t>& columns = layout.columns(row);
  for (std::size_t k = 0; k < columns.size(); ++k)
    if (returned.cells[row * width + k] != 0) act(row * width + columns[k]);
}

// The levels of a row that minimise error plus the costs of transitions: dynamic programming, as in Viterbi's algorithm
// (1967).
void choose(const Candidates& candidates, const Transitions& transitions, CostToGo& to_go, const Values& row,
            Values& levels) {
  to_go.compute(candidates, transitions, row.data(), row.size());
  levels.resize(row.size());
  for (std::size_t k = 0; k < row.size(); ++k) {
    const Candidates::Choices& choices = candidates.of(row[k]);
    std::array<Cost, kCandidates> costs;
    for (std::size_t i = 0; i < kCandidates; ++i)
      costs[i] = choices.error[i] + to_go.of(k)[i] + (k == 0 ? 0 : transitions.after(levels[k - 1])[choices.first + i]);
    levels[k] = static_cast<std::uint8_t>(std::min_element(costs.begin(), costs.end()) - costs.begin() + choices.first);
  }
}

// Costs of transitions, estimated from some rows in turns with the choice of their levels; moves the levels to their
// means.
Transitions transitions_of(const std::vector<Values>& rows, Values& value, Lambda lambda) {
  Transitions transitions(value.size());
  CostToGo to_go;
  Values levels;
  for (int round = 0; round <= kRounds; ++round) {
    const Candidates candidates(value);
    Centroids centroids;
    for (const Values& row : rows) {
      if (round == 0) {
        levels.clear();
        for (const std::uint8_t x : row) levels.push_back(candidates.of(x).nearest);
      } else {
        choose(candidates, transitions, to_go, row, levels);
      }
      for (std::size_t k = 0; k < row.size(); ++k) {
        centroids.count(levels[k], row[k]);
        if (k > 0) transitions.count(levels[k - 1], levels[k]);
      }
    }
    centroids.move(value);
    transitions.learn(lambda);
  }
  return transitions;
}

}  // namespace

std::vector<std::uint8_t> choose_levels(const std::uint8_t* values, const std::uint8_t* returns,
                                        const MaskGeometry& geometry, std::size_t levels) {
  if (levels < 2 || levels > 255) throw Error(ErrorCode::Section, "intensity levels other than 2 to 255");
  const std::size_t width = geometry.width;
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, width);
  Counts counts{};
  std::vector<Values> rows(kMaskRows);
  for (std::size_t row = 0; row < kMaskRows; ++row)
    for_each_return(layout, returned, width, row, [&](std::size_t at) {
      rows[row].push_back(values[at]);
      ++counts[values[at]];
    });
  LloydMaxLevels lloyd_max(counts, levels);
  Values& value = lloyd_max.value;
  const Lambda lambda = lambda_for(lloyd_max);
  const bool optimises = lloyd_max.error != 0 && value.size() <= kMaxLevels;

  std::optional<Transitions> transitions;
  if (optimises) {
    const std::size_t every = 1 + returned.returns / kSampledReturns;
    std::vector<Values> some;
    for (std::size_t row = every / 2; row < kMaskRows; row += every) some.push_back(rows[row]);
    transitions = transitions_of(some, value, lambda);
  }
  const Candidates candidates(value);
  CostToGo to_go;
  Centroids centroids;
  std::vector<Values> chosen(kMaskRows);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    if (optimises) {
      choose(candidates, *transitions, to_go, rows[row], chosen[row]);
    } else {
      for (const std::uint8_t x : rows[row]) chosen[row].push_back(candidates.of(x).nearest);
    }
    for (std::size_t k = 0; k < rows[row].size(); ++k) centroids.count(chosen[row][k], rows[row][k]);
  }
  centroids.move(value);
  Values image(kMaskRows * width);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    std::size_t k = 0;
    for_each_return(layout, returned, width, row, [&](std::size_t at) { image[at] = value[chosen[row][k++]]; });
  }
  return image;
}

}  // namespace lidarcodec
