#include "bits/number_series.hpp"

#include <algorithm>
#include <bit>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

using Series = std::vector<std::int64_t>;
__extension__ using Wide = __int128;

constexpr std::int64_t kMostLevel = std::int64_t{1} << 62, kMostRate = std::int64_t{1} << 45;

// Arithmetic modulo 2^64.
std::int64_t sum(std::int64_t a, std::int64_t b) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) + static_cast<std::uint64_t>(b));
}
std::int64_t difference(std::int64_t a, std::int64_t b) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) - static_cast<std::uint64_t>(b));
}

Wide floor_divided(Wide of, Wide by) { return of / by - (of % by != 0 && (of < 0) != (by < 0)); }

std::int64_t centred(std::int64_t value, std::int64_t modulus) {
  const std::int64_t low = modulus / 2, moved = sum(value, low) % modulus;
  return (moved < 0 ? moved + modulus : moved) - low;
}

std::int64_t bounded(Wide value, std::int64_t limit) {
  return static_cast<std::int64_t>(std::clamp<Wide>(value, -limit, limit));
}

std::int64_t median(Series values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct Line {
  std::int64_t level = 0, rate = 0;
  std::int64_t at(std::size_t place) const {
    const auto risen = static_cast<std::int64_t>(place * static_cast<std::uint64_t>(rate));
    return sum(level, risen >> 10);
  }
};

// The line of a form. steps: from each value to the next.
Line line_of(const Series& values, const Series& steps, SeriesForm form) {
  if (values.empty()) return {};
  if (steps.empty() || form == SeriesForm::Alternating) return {values[0], 0};
  if (form != SeriesForm::Level) return {values[0], bounded(Wide{1024} * median(steps), kMostRate)};
  Series path = {0};
  for (const std::int64_t step : steps) path.push_back(sum(path.back(), step));
  const std::size_t half =
      path.size() / 2;  // the rate is the rise from the mean of the first half to that of the second
  std::int64_t first = 0, last = 0;
  for (std::size_t i = 0; i < half; ++i) {
    first = sum(first, path[i]);
    last = sum(last, path[path.size() - half + i]);
  }
  const Wide rise = Wide{last} - first;
  Line line{0, bounded(floor_divided(rise * 1024, static_cast<Wide>(half * (path.size() - half))), kMostRate)};
  for (std::size_t i = 0; i < path.size(); ++i) path[i] = difference(path[i], line.at(i));
  line.level = bounded(Wide{values[0]} + median(std::move(path)), kMostLevel);
  return line;
}

// The residuals of a series.
Series residuals_of(const Series& values, SeriesForm form, const Line& line) {
  Series residuals;
  for (std::size_t i = 0; i < values.size(); ++i) residuals.push_back(difference(values[i], line.at(i)));
  const auto lagged = [&](std::size_t lag, std::size_t from) {
    for (std::size_t i = residuals.size(); i-- > from;) residuals[i] = difference(residuals[i], residuals[i - lag]);
  };
  if (form == SeriesForm::Alternating) lagged(2, 2);
  if (form == SeriesForm::First || form == SeriesForm::Second) lagged(1, 1);
  if (form == SeriesForm::Second) lagged(1, 2);
  return residuals;
}

// log2(1 + |x|) in 1/256 bit, linear within each octave.
std::uint64_t cost_of(std::int64_t x) {
  const std::uint64_t size = 1 + (x < 0 ? 0 - static_cast<std::uint64_t>(x) : static_cast<std::uint64_t>(x));
  const auto octave = static_cast<int>(std::bit_width(size)) - 1;
  return static_cast<std::uint64_t>(octave) << 8 | (size << (63 - octave) >> 55 & 255);
}

}  // namespace

SeriesFit best_form(const std::vector<std::int64_t>& values, std::int64_t modulus) {
  const auto reduced = [modulus](Series series) {
    if (modulus != 0)
      for (std::int64_t& x : series) x = centred(x, modulus);
    return series;
  };
  Series steps;
  for (std::size_t i = 1; i < values.size(); ++i) steps.push_back(difference(values[i], values[i - 1]));
  steps = reduced(std::move(steps));
  SeriesFit best;
  for (const SeriesForm form : {SeriesForm::Level, SeriesForm::First, SeriesForm::Second, SeriesForm::Alternating}) {
    const Line line = line_of(values, steps, form);
    SeriesFit fit{form, line.level, line.rate, reduced(residuals_of(values, form, line)), 0};
    for (const std::int64_t x : fit.residuals) fit.cost += cost_of(x);
    if (fit.cost < best.cost) best = std::move(fit);
  }
  return best;
}

std::size_t best_period(const std::uint8_t* types, std::size_t count, std::size_t longest) {
  if (longest < 1 || longest > kLongestPeriod)
    throw Error(ErrorCode::Section, "a period of types is 1 to 32 packets long");
  std::size_t best = 1, least = ~std::size_t{0};
  for (std::size_t period = 1; period <= longest; ++period) {
    std::size_t cost = period;
    for (std::size_t i = period; i < count; ++i) cost += types[i] != types[i - period];
    if (cost < least) {
      least = cost;
      best = period;
    }
  }
  return best;
}

}  // namespace lidarcodec
