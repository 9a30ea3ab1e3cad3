#include "session/pictures/mapping.hpp"

#include <algorithm>
#include <cmath>
#include <string>

namespace lidarcodec {
namespace {

constexpr double kLogKneeUm = 10'000'000;  // 10 m
constexpr std::uint32_t kCentimetreUm = 10'000;
constexpr unsigned kFold = 5;  // `paper` is 0 at 2^5 - 1 cm

// The sum of two doubles, the second one a rounding error of the first: numbers of 104 bits, so that a range is never
// rounded another way than in Python, which has 30 decimal digits.
struct Long {
  double high = 0, low = 0;
};

// a + b, where a is the larger one.
Long quick_sum(double a, double b) {
  const double sum = a + b;
  return {sum, b - (sum - a)};
}

Long operator+(const Long& a, const Long& b) {
  const double sum = a.high + b.high, part = sum - a.high;
  return quick_sum(sum, (a.high - (sum - part)) + (b.high - part) + a.low + b.low);
}

Long operator*(const Long& a, const Long& b) {
  const double product = a.high * b.high;
  return quick_sum(product, std::fma(a.high, b.high, -product) + (a.high * b.low + a.low * b.high));
}

Long operator/(const Long& a, const Long& b) {
  const double first = a.high / b.high;
  const Long left = a + Long{-first} * b;
  const double second = left.high / b.high;
  const Long rest = left + Long{-second} * b;
  return quick_sum(first, second) + Long{rest.high / b.high};
}

Long power(Long base, unsigned exponent) {
  Long found{1};
  for (; exponent != 0; exponent >>= 1, base = base * base)
    if ((exponent & 1u) != 0) found = found * base;
  return found;
}

// The root of a number of at least 1, by Newton's method.
Long root(const Long& of, unsigned degree) {
  Long found{std::pow(of.high, 1.0 / degree)};
  for (int round = 0; round < 3; ++round) {
    const Long off = of / power(found, degree) + Long{-1};
    found = found + found * off / Long{static_cast<double>(degree)};
  }
  return found;
}

// The nearest whole number, at most `top`.
std::int32_t rounded(const Long& value, std::uint32_t top) {
  const Long more = value + Long{0.5};
  double whole = std::floor(more.high);
  if (whole == more.high && more.low < 0) --whole;
  return static_cast<std::int32_t>(std::min(whole, static_cast<double>(top)));
}

std::vector<std::int32_t> log_ranges(std::uint32_t peak, std::uint32_t top, std::uint32_t step_um) {
  const Long knee = Long{kLogKneeUm} / Long{static_cast<double>(step_um)};
  const Long farthest = Long{1} + Long{static_cast<double>(std::uint64_t{top} * step_um)} / Long{kLogKneeUm};
  const Long ratio = root(farthest, peak);
  std::vector<std::int32_t> ranges;
  Long grown{1};
  for (std::uint32_t sample = 0; sample <= peak; ++sample, grown = grown * ratio)
    ranges.push_back(rounded(knee * (grown + Long{-1}), top));
  return ranges;
}

// 2^(bits - 4) samples to an octave. Whole octaves are whole centimetres, whose halves of a step round up.
std::vector<std::int32_t> paper_ranges(unsigned bits, std::uint32_t top, std::uint32_t step_um) {
  const std::uint32_t octave = 1u << (bits - 4);
  const Long ratio = root({2}, octave), steps = Long{kCentimetreUm} / Long{static_cast<double>(step_um)};
  std::vector<std::int32_t> ranges;
  Long grown{1};
  for (std::uint32_t sample = 0; sample < 1u << bits; ++sample) {
    const std::uint32_t octaves = kFold + sample / octave;
    if (sample % octave == 0) {
      grown = {1};
      const std::uint64_t twice = 2 * kCentimetreUm * ((std::uint64_t{1} << octaves) - 1);
      ranges.push_back(
          static_cast<std::int32_t>(std::min<std::uint64_t>((twice + step_um) / (2 * std::uint64_t{step_um}), top)));
      continue;
    }
    grown = grown * ratio;
    const double scale = std::ldexp(1.0, static_cast<int>(octaves));
    ranges.push_back(rounded((Long{grown.high * scale, grown.low * scale} + Long{-1}) * steps, top));
  }
  return ranges;
}

}  // namespace

RangeScale RangeScale::of(std::uint32_t most, std::uint32_t range_step) {
  const double step_m = range_step / 1e7;
  return {most, std::max(static_cast<std::uint32_t>(std::nearbyint(step_m * 1e6)), 1u)};
}

std::vector<std::int32_t> ranges_of_samples(Mapping mapping, unsigned bits, std::uint32_t top, std::uint32_t step_um) {
  const std::uint64_t peak = (1u << bits) - 1;
  if (mapping == Mapping::Log) return log_ranges(static_cast<std::uint32_t>(peak), top, step_um);
  if (mapping == Mapping::Paper) return paper_ranges(bits, top, step_um);
  std::vector<std::int32_t> ranges;
  for (std::uint64_t sample = 0; sample <= peak; ++sample)
    ranges.push_back(static_cast<std::int32_t>(mapping == Mapping::Linear
                                                   ? (2 * sample * top + peak) / (2 * peak)
                                                   : (2 * sample * sample * top + peak * peak) / (2 * peak * peak)));
  return ranges;
}

std::vector<std::uint16_t> mapped_samples(const Outside& outside, const Picture& picture) {
  std::vector<std::uint16_t> samples = samples_of(outside, picture);
  if (std::any_of(samples.begin(), samples.end(), [&](std::uint16_t sample) { return sample >> picture.bits != 0; }))
    throw Error(ErrorCode::Section, "a picture with samples beyond " + std::to_string(picture.bits) + " bits");
  return samples;
}

}  // namespace lidarcodec
