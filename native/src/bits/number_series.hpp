// The best predictor of a series of whole numbers, such as time stamps. lidarcodec/entropy/number_series.py defines the
// forms.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

enum class SeriesForm : std::uint8_t { Level, First, Second, Alternating };

// A form, its straight line, the residuals, and their approximate cost in 1/256 bit.
struct SeriesFit {
  SeriesForm form = SeriesForm::Level;
  std::int64_t level = 0, rate = 0;
  std::vector<std::int64_t> residuals;
  std::uint64_t cost = ~std::uint64_t{0};
};

// The form with the cheapest residuals. modulus: residuals are reduced to the range around 0; 0: they are not.
SeriesFit best_form(const std::vector<std::int64_t>& values, std::int64_t modulus);

inline constexpr std::size_t kLongestPeriod = 32;  // docs/wire-format-sections.md

// The period, 1 to `longest`, with the fewest types that differ from the one a period before. Raises Section unless
// `longest` is 1 to kLongestPeriod.
std::size_t best_period(const std::uint8_t* types, std::size_t count, std::size_t longest);

}  // namespace lidarcodec
