// Any bytes as a keep section, and any keep mask there and back. The input's first bytes say width, firings and sensor.
#include <algorithm>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "parts/fuzz_geometry.hpp"
#include "parts/fuzz_input.hpp"
#include "planes/keep_coder.hpp"

using lidarcodec::EarlierMask;
using lidarcodec::kMaskRows;
using lidarcodec::MaskGeometry;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width = input.below(48);
  const std::uint8_t pattern = input.byte(), turned = input.byte(), split = input.byte(), kind = input.byte();
  const std::uint32_t step = input.below(40000);  // azimuths beyond a turn are refused

  const FuzzGeometry any(width, pattern, turned, split >= 128);
  const MaskGeometry& geometry = any.image;
  const std::vector<std::uint8_t>& fired = any.fired;
  std::vector<std::uint16_t> azimuth(2 * width);
  for (std::size_t i = 0; i < azimuth.size(); ++i)
    azimuth[i] = static_cast<std::uint16_t>(kind & 4u ? i * step : i % width * step % 36000);
  EarlierMask earlier;
  std::vector<std::uint8_t> before;
  if (kind & 1u) {
    earlier.width = kind & 8u ? width + 1 : width;  // one that does not fit is refused
    before.resize(kMaskRows * earlier.width);
    for (std::size_t i = 0; i < before.size(); ++i) before[i] = (i * 7 + split) % 11 > 8;
    earlier.cells = before.data();
  }
  const std::vector<std::uint8_t> rest = input.rest();
  std::vector<std::uint8_t> mask;
  try {
    mask = lidarcodec::decode_keep(rest.data(), rest.size(), geometry, azimuth.data(), earlier);
    const EarlierMask used = rest[0] == 5 ? earlier : EarlierMask{};
    if (lidarcodec::encode_keep(mask.data(), geometry, azimuth.data(), used) != rest) std::abort();
  } catch (const lidarcodec::Error&) {
  }
  if (rest.empty()) return 0;
  mask.assign(kMaskRows * width, 0);
  for (std::size_t i = 0; i < mask.size(); ++i) {
    const std::size_t row = i / width, column = i % width;
    mask[i] = (kind & 2u || fired[geometry.half[row] * width + column]) && (rest[i / 8 % rest.size()] >> (i % 8) & 1u);
  }
  try {
    const std::vector<std::uint8_t> coded = lidarcodec::encode_keep(mask.data(), geometry, azimuth.data(), earlier);
    if (lidarcodec::decode_keep(coded.data(), coded.size(), geometry, azimuth.data(), earlier) != mask) std::abort();
  } catch (const lidarcodec::Error&) {
  }
  return 0;
}
