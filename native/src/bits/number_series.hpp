// What suits a series of whole numbers, such as time stamps, best: lidarcodec/entropy/number_series.py says what the forms are.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

enum class SeriesForm : std::uint8_t { Level, First, Second, Alternating };

// A form, its straight line, what is left of the series, and about what that costs: 256ths of a bit.
struct SeriesFit {
  SeriesForm form = SeriesForm::Level;
  std::int64_t level = 0, rate = 0;
  std::vector<std::int64_t> left;
  std::uint64_t cost = ~std::uint64_t{0};
};

// The cheapest. modulus: what is left is centred in it; 0: it is left as it is.
SeriesFit best_form(const std::vector<std::int64_t>& values, std::int64_t modulus);

inline constexpr std::size_t kLongestPeriod = 32;  // docs/wire-format-sections.md

// Period, 1 to `longest`, by which most of the types are those one period before. Raises Section unless `longest` is 1 to
// kLongestPeriod.
std::size_t best_period(const std::uint8_t* types, std::size_t count, std::size_t longest);

}  // namespace lidarcodec
