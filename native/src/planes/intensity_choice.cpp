#include "planes/intensity_choice.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <optional>

#include "base/error.hpp"
#include "planes/intensity_costs.hpp"
#include "mask/rows.hpp"

namespace lidarcodec {
namespace {

using Counts = std::array<std::size_t, 256>;
using Values = std::vector<std::uint8_t>;

constexpr std::size_t kSampled = 16384;   // returns whose rows tell how levels follow each other
constexpr int kRounds = 4;               // of learning it
constexpr std::size_t kMostLevels = 64;  // among more a choice is worth little: each return becomes the nearest

// Levels for a histogram, each the mean of the intensities that are nearest to it (Max 1960, Lloyd 1982). They begin evenly
// spaced. `error`: the mean squared error, 16 times.
struct Means {
  Values value;
  Cost error = 0;

  Means(const Counts& counts, std::size_t levels) {
    Values used;
    for (std::size_t x = 0; x < counts.size(); ++x)
      if (counts[x] != 0) used.push_back(static_cast<std::uint8_t>(x));
    value = used;
    if (used.size() <= levels) return;
    std::vector<std::int64_t> at16(levels);
    const std::int64_t low = used.front(), high = used.back();
    for (std::size_t s = 0; s < levels; ++s)
      at16[s] = 16 * low + 16 * (high - low) * static_cast<std::int64_t>(s) / static_cast<std::int64_t>(levels - 1);
    for (int round = levels > kMostLevels ? 6 : 24; round > 0; --round) {
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

// What a bit is worth: some times the error that so many levels leave at least. Among few, many bits are to be saved by few
// errors, as neighbours are alike but for noise; among many, noise is most of what is coded.
Worth worth_for(const Means& means) {
  const std::size_t levels = std::max<std::size_t>(means.value.size(), 10);
  return {static_cast<Cost>(std::int64_t{48} * means.error / static_cast<std::int64_t>(levels))};
}

// What became which level.
class Became {
 public:
  void count(std::size_t level, std::uint8_t intensity) {
    ++returns_[level];
    sum_[level] += intensity;
  }

  // Moves each level to the mean of what became it. They stay distinct, and rising.
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
void for_each_return(const MaskLayout& layout, const ClosedRows& returned, std::size_t width, std::size_t row, const Act& act) {
  const std::vector<std::uint32_t>& columns = layout.columns(row);
  for (std::size_t k = 0; k < columns.size(); ++k)
    if (returned.cells[row * width + k] != 0) act(row * width + columns[k]);
}

// The levels of a row's intensities, those that cost least by `turns` alone.
void choose(const Candidates& candidates, const Turns& turns, Ahead& ahead, const Values& row, Values& levels) {
  ahead.look(candidates, turns, row.data(), row.size());
  levels.resize(row.size());
  for (std::size_t k = 0; k < row.size(); ++k) {
    const Candidates::Choices& choices = candidates.of(row[k]);
    std::array<Cost, kCandidates> costs;
    for (std::size_t i = 0; i < kCandidates; ++i)
      costs[i] = choices.error[i] + ahead.of(k)[i] + (k == 0 ? 0 : turns.after(levels[k - 1])[choices.first + i]);
    levels[k] = static_cast<std::uint8_t>(std::min_element(costs.begin(), costs.end()) - costs.begin() + choices.first);
  }
}

// How levels follow each other once they are chosen, from some rows; moves the levels to the means of what becomes them.
Turns turns_of(const std::vector<Values>& rows, Values& value, Worth worth) {
  Turns turns(value.size());
  Ahead ahead;
  Values levels;
  for (int round = 0; round <= kRounds; ++round) {
    const Candidates candidates(value);
    Became became;
    for (const Values& row : rows) {
      if (round == 0) {
        levels.clear();
        for (const std::uint8_t x : row) levels.push_back(candidates.of(x).nearest);
      } else {
        choose(candidates, turns, ahead, row, levels);
      }
      for (std::size_t k = 0; k < row.size(); ++k) {
        became.count(levels[k], row[k]);
        if (k > 0) turns.see(levels[k - 1], levels[k]);
      }
    }
    became.move(value);
    turns.learn(worth);
  }
  return turns;
}

}  // namespace

std::vector<std::uint8_t> choose_levels(const std::uint8_t* values, const std::uint8_t* returns, const MaskGeometry& geometry,
                                        std::size_t levels) {
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
  Means means(counts, levels);
  Values& value = means.value;
  const Worth worth = worth_for(means);
  const bool looks = means.error != 0 && value.size() <= kMostLevels;

  std::optional<Turns> turns;
  if (looks) {
    const std::size_t every = 1 + returned.returns / kSampled;
    std::vector<Values> some;
    for (std::size_t row = every / 2; row < kMaskRows; row += every) some.push_back(rows[row]);
    turns = turns_of(some, value, worth);
  }
  const Candidates candidates(value);
  Ahead ahead;
  Became became;
  std::vector<Values> chosen(kMaskRows);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    if (looks) {
      choose(candidates, *turns, ahead, rows[row], chosen[row]);
    } else {
      for (const std::uint8_t x : rows[row]) chosen[row].push_back(candidates.of(x).nearest);
    }
    for (std::size_t k = 0; k < rows[row].size(); ++k) became.count(chosen[row][k], rows[row][k]);
  }
  became.move(value);
  Values image(kMaskRows * width);
  for (std::size_t row = 0; row < kMaskRows; ++row) {
    std::size_t k = 0;
    for_each_return(layout, returned, width, row, [&](std::size_t at) { image[at] = value[chosen[row][k++]]; });
  }
  return image;
}

}  // namespace lidarcodec
