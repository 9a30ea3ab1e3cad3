// Any bytes as a mask section, and any mask there and back. The input's first bytes say width, firings and sensor.
#include <algorithm>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "mask/coder.hpp"
#include "parts/fuzz_geometry.hpp"
#include "parts/fuzz_input.hpp"

using lidarcodec::EarlierMask;
using lidarcodec::kMaskRows;
using lidarcodec::MaskGeometry;

namespace {

void check_round_trip(const std::vector<std::uint8_t>& mask, const MaskGeometry& geometry, EarlierMask earlier,
                      std::uint32_t turn) {
  const std::vector<std::uint8_t> data = lidarcodec::encode_mask(mask.data(), geometry, earlier, turn);
  if (lidarcodec::decode_mask(data.data(), data.size(), geometry, earlier) != mask) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width = input.below(48);
  const std::uint8_t pattern = input.byte(), turned = input.byte(), split = input.byte(), kind = input.byte();
  const std::uint32_t turn = input.below(65536);  // 0: found from the mask

  const FuzzGeometry any(width, pattern, turned, split >= 128);
  const MaskGeometry& geometry = any.image;
  const std::vector<std::uint8_t>& fired = any.fired;
  EarlierMask earlier;
  std::vector<std::uint8_t> before;
  if (kind & 1u) {
    earlier.width = 1 + split % 40;
    before.resize(kMaskRows * earlier.width);
    for (std::size_t i = 0; i < before.size(); ++i) before[i] = (i * 7 + split) % 11 > 2;
    earlier.cells = before.data();
  }
  const std::vector<std::uint8_t> rest = input.rest();
  try {
    check_round_trip(lidarcodec::decode_mask(rest.data(), rest.size(), geometry, earlier), geometry, earlier, turn);
  } catch (const lidarcodec::Error&) {
  }
  if (kind & 2u && width > 0 && !rest.empty()) {
    std::vector<std::uint8_t> mask(kMaskRows * width);
    for (std::size_t i = 0; i < mask.size(); ++i) {
      const std::size_t row = i / width, column = i % width;
      mask[i] = fired[geometry.half[row] * width + column] && (rest[i / 8 % rest.size()] >> (i % 8) & 1u);
    }
    check_round_trip(mask, geometry, earlier, turn);
  }
  return 0;
}
