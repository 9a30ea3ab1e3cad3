// Any bytes as streams of numbers. What decodes must be, byte for byte, what the encoder writes for it. The same
// numbers as a series, of which what suits it best must leave as many.
#include <array>
#include <cstdlib>

#include "base/error.hpp"
#include "bits/number_series.hpp"
#include "bits/numbers.hpp"
#include "parts/fuzz_input.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::vector<std::size_t> counts = {input.below(100), input.below(300), input.below(20)};
  const std::vector<std::uint8_t> rest = input.rest();
  try {
    const std::vector<std::uint64_t> values = lidarcodec::decode_numbers(rest.data(), rest.size(), counts);
    if (lidarcodec::encode_numbers(values.data(), counts) != rest) std::abort();
  } catch (const lidarcodec::Error&) {
  }
  std::vector<std::uint64_t> values(counts[0] + counts[1] + counts[2]);
  for (std::uint64_t& value : values) {
    const int bytes = input.byte() % 9;
    for (int i = 0; i < bytes; ++i) value = value << 8 | input.byte();
  }
  const std::vector<std::uint8_t> encoded = lidarcodec::encode_numbers(values.data(), counts);
  if (lidarcodec::decode_numbers(encoded.data(), encoded.size(), counts) != values) std::abort();
  std::vector<std::int64_t> series;
  for (const std::uint64_t value : values) series.push_back(static_cast<std::int64_t>(value));
  constexpr std::array<std::int64_t, 5> kModuli = {0, 1, 256, 3'600'000'000, std::int64_t{1} << 62};
  const lidarcodec::SeriesFit fit = lidarcodec::best_form(series, kModuli[counts[0] % kModuli.size()]);
  if (fit.residuals.size() != series.size() || fit.form > lidarcodec::SeriesForm::Alternating) std::abort();
  const std::size_t longest = 1 + counts[2], period = lidarcodec::best_period(rest.data(), rest.size(), longest);
  if (period < 1 || period > longest) std::abort();
  return 0;
}
