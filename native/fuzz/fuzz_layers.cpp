// Any bytes as refined ranges, and any ranges there and back. The input's first bytes say width, firings, base and
// steps.
#include <algorithm>
#include <array>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "layers/range_refiner.hpp"
#include "parts/fuzz_geometry.hpp"
#include "parts/fuzz_input.hpp"

using lidarcodec::kMaskRows;
using lidarcodec::LayerImage;
using lidarcodec::LayerSteps;

namespace {

using Ranges = std::vector<std::uint16_t>;

bool within(const Ranges& a, const Ranges& b, std::uint32_t most) {
  for (std::size_t i = 0; i < a.size(); ++i)
    if (static_cast<std::uint32_t>(std::abs(int{a[i]} - int{b[i]})) > most) return false;
  return true;
}

// Steps from a base that are allowed: odd, the finer one smaller.
LayerSteps steps_of(std::uint32_t base, std::uint32_t fine, std::uint32_t turn) {
  const std::uint32_t wide = 3 + 2 * (base % ((lidarcodec::kMaxLayerStep - 1) / 2));
  return {wide, 1 + 2 * (fine % (wide / 2)), turn};
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width = input.below(13);
  const std::uint8_t pattern = input.byte(), holes = input.byte(), turned = input.byte(), kind = input.byte();
  const std::uint32_t base_step = input.below(65536), fine_step = input.below(65536), turn = input.below(65536);
  const std::uint8_t spread = input.byte();
  const std::vector<std::uint8_t> rest = input.rest();

  const FuzzGeometry any(width, pattern, turned, (kind & 4u) != 0);
  const std::vector<std::uint8_t> returns = any.returns(holes);
  Ranges base(returns.size());
  Numbers numbers(rest);
  for (std::size_t i = 0; i < base.size(); ++i)
    if (returns[i] != 0)
      base[i] = (kind & 8u) ? static_cast<std::uint16_t>(std::max(numbers.next(2), 1u))
                            : static_cast<std::uint16_t>(1 + (spread * 257u + i * (spread % 16)) % 65535);
  std::array<std::int32_t, kMaskRows> level{};
  for (std::size_t row = 0; row < kMaskRows; ++row) level[row] = static_cast<std::int32_t>(row * turned % 1001);
  const LayerImage image{any.image, base.data(), level.data()};
  const LayerSteps steps = steps_of(base_step, fine_step, turn);

  const std::uint32_t half = steps.base / 2;
  try {
    const Ranges found = lidarcodec::decode_refinement(rest.data(), rest.size(), image, steps);
    if (!within(found, base, half)) std::abort();
    const bool inside = std::all_of(base.begin(), base.end(), [&](std::uint16_t range) {
      return range == 0 || (range > half && range + half <= 65535);
    });
    if (inside && lidarcodec::encode_refinement(image, found.data(), steps) != rest)
      std::abort();  // each list of decisions has one stream, and each cell one range
  } catch (const lidarcodec::Error&) {
  }
  if (kind & 2u) {
    Ranges ranges(base.size());
    for (std::size_t i = 0; i < ranges.size(); ++i)
      if (base[i] != 0) {
        const auto by = static_cast<std::int32_t>(numbers.next(2) % steps.base) - static_cast<std::int32_t>(half);
        ranges[i] = static_cast<std::uint16_t>(std::clamp(int{base[i]} + by, 1, 65535));
      }
    const std::vector<std::uint8_t> coded = lidarcodec::encode_refinement(image, ranges.data(), steps);
    if (!within(lidarcodec::decode_refinement(coded.data(), coded.size(), image, steps), ranges, steps.fine / 2))
      std::abort();
  }
  return 0;
}
