// The choice of few intensities: any intensities of any returns, in any number of levels. What is chosen has no more
// values than that, lies between the least and the greatest intensity and only where there are returns, and is what it
// was where that has few values. How it is coded is what fuzz_intensity tries. The input's first bytes say width,
// firings and sensor.
#include <algorithm>
#include <bitset>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "parts/fuzz_geometry.hpp"
#include "parts/fuzz_input.hpp"
#include "planes/intensity_choice.hpp"

namespace {

using Bytes = std::vector<std::uint8_t>;

// Which values the returns have.
std::bitset<256> values_of(const Bytes& image, const Bytes& returns) {
  std::bitset<256> values;
  for (std::size_t i = 0; i < image.size(); ++i)
    if (returns[i] != 0) values.set(image[i]);
  return values;
}

void check(bool holds) {
  if (!holds) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width = input.below(13);
  const std::uint8_t pattern = input.byte(), holes = input.byte(), turned = input.byte(), kind = input.byte();
  const std::size_t levels = kind & 2u ? input.byte() % 18u : input.byte();  // 0 and 1 are refused
  const std::uint8_t low = input.byte(), spread = input.byte();

  const FuzzGeometry any(width, pattern, turned, (kind & 4u) != 0);
  Bytes returns = any.returns(holes);
  if (kind & 8u && !returns.empty())
    returns[std::size_t{turned} * 251 % returns.size()] = 1;  // where nothing may have fired
  const Bytes rest = input.rest();
  Bytes image(returns.size());
  for (std::size_t i = 0; i < image.size() && !rest.empty(); ++i) {
    const std::uint8_t at = rest[i % rest.size()];
    image[i] = kind & 1u ? static_cast<std::uint8_t>(low + (spread * at >> 8)) : at;  // a narrow range, or any
  }
  try {
    const Bytes chosen = lidarcodec::choose_levels(image.data(), returns.data(), any.image, levels);
    const std::bitset<256> had = values_of(image, returns), has = values_of(chosen, returns);
    check(chosen.size() == image.size() && has.count() <= std::max<std::size_t>(levels, 1));
    std::size_t least = 0, most = 255;
    while (least < 256 && !had[least]) ++least;
    while (most > 0 && !had[most]) --most;
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      if (returns[i] == 0)
        check(chosen[i] == 0);
      else
        check(chosen[i] >= least && chosen[i] <= most && (had.count() > levels || chosen[i] == image[i]));
    }
  } catch (const lidarcodec::Error&) {
  }
  return 0;
}
