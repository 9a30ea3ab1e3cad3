// Any bytes as intensities, and any intensities there and back. The input's first bytes say width, firings and sensor.
#include <algorithm>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "bits/rangecoder.hpp"
#include "parts/fuzz_geometry.hpp"
#include "parts/fuzz_input.hpp"
#include "planes/intensity_coder.hpp"
#include "planes/intensity_symbols.hpp"

using lidarcodec::kMaskRows;
using lidarcodec::MaskGeometry;

namespace {

using Bytes = std::vector<std::uint8_t>;

void check_round_trip(Bytes image, const Bytes& returns, const MaskGeometry& geometry, std::uint32_t turn) {
  const Bytes data = lidarcodec::encode_intensity(image.data(), returns.data(), geometry, turn);
  for (std::size_t i = 0; i < image.size(); ++i) image[i] = returns[i] != 0 ? image[i] : std::uint8_t{0};
  if (lidarcodec::decode_intensity(data.data(), data.size(), returns.data(), geometry) != image) std::abort();
}

// Azimuths of (2, W), below 36000.
std::vector<std::uint16_t> azimuths(std::size_t width, std::uint8_t step) {
  std::vector<std::uint16_t> angles(2 * width);
  for (std::size_t i = 0; i < angles.size(); ++i) angles[i] = static_cast<std::uint16_t>(i * step * 37 % 36000);
  return angles;
}

// The same image three times, as parts of a turn or, if it `follows`, frames that go on from each other.
void check_parts(const Bytes& image, const Bytes& returns, const MaskGeometry& geometry, std::uint32_t turn,
                 const std::vector<std::uint16_t>& angles, bool follows) {
  lidarcodec::IntensityMemory writes, reads;
  writes.follows = follows;
  Bytes expected(image.size());
  for (std::size_t i = 0; i < image.size(); ++i) expected[i] = returns[i] != 0 ? image[i] : std::uint8_t{0};
  for (int part = 0; part < 3; ++part) {
    const Bytes data =
        lidarcodec::encode_intensity(image.data(), returns.data(), geometry, turn, &writes, angles.data());
    if (lidarcodec::decode_intensity(data.data(), data.size(), returns.data(), geometry, &reads, angles.data()) !=
        expected)
      std::abort();
  }
}

// A section whose header and symbols are sound, so that the input is read as the streams of the returns.
Bytes with_sound_head(std::uint8_t kind, const Bytes& streams, std::uint8_t levels, std::uint32_t turn,
                      std::uint8_t split) {
  lidarcodec::Symbols symbols;
  const std::size_t count = std::max<std::size_t>(levels, 2);
  for (std::size_t s = 0; s < count; ++s) {
    symbols.value.push_back(static_cast<std::uint8_t>(s * 255 / (count - 1)));
    symbols.mass_class.push_back(static_cast<std::uint8_t>(s * (lidarcodec::kMassClasses - 1) / (count - 1)));
  }
  Bytes head;
  lidarcodec::BitWriter bits(head);
  lidarcodec::code_symbols(bits, symbols);
  bits.finish();
  const auto first = static_cast<std::uint8_t>(streams.size() * split / 256 % 256);
  Bytes data = {kind,
                static_cast<std::uint8_t>(turn),
                static_cast<std::uint8_t>(turn >> 8),
                0x60,
                3,
                static_cast<std::uint8_t>(head.size()),
                0,
                first,
                0,
                0,
                0};
  data.insert(data.end(), head.begin(), head.end());
  data.insert(data.end(), streams.begin(), streams.end());
  return data;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width = input.below(13);  // wider ones take longer and show nothing else
  const std::uint8_t pattern = input.byte(), holes = input.byte(), turned = input.byte(), kind = input.byte();
  const std::uint8_t levels = input.byte(), split = input.byte();
  const std::uint32_t turn = input.below(65536);  // 0: found from the returns

  const FuzzGeometry any(width, pattern, turned, (kind & 4u) != 0);
  const MaskGeometry& geometry = any.image;
  const Bytes returns = any.returns(holes);

  const Bytes rest = input.rest();
  const std::vector<std::uint16_t> angles = azimuths(width, turned);
  const auto decoded = [&](const Bytes& coded, lidarcodec::IntensityMemory* memory) {
    return lidarcodec::decode_intensity(coded.data(), coded.size(), returns.data(), geometry, memory, angles.data());
  };
  try {
    const std::uint8_t begins = (kind & 8u) ? 3 : 1;
    const Bytes coded = (kind & 1u) ? with_sound_head(begins, rest, levels, turn, split) : rest;
    lidarcodec::IntensityMemory memory;  // of a section, and any bytes as one that goes on from it
    check_round_trip(decoded(coded, &memory), returns, geometry, turn);
    Bytes on = rest;
    if (!on.empty()) on[0] = 2;
    decoded(on, &memory);
  } catch (const lidarcodec::Error&) {
  }
  if (kind & 2u && !returns.empty() && !rest.empty()) {
    Bytes image(returns.size());
    for (std::size_t i = 0; i < image.size(); ++i) image[i] = rest[i % rest.size()];
    check_round_trip(image, returns, geometry, turn);
    check_parts(image, returns, geometry, turn, angles, (kind & 8u) != 0);
  }
  return 0;
}
