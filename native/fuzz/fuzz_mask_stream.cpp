// Any bytes as masks of a stream with memory, and any masks there and back. The input's first bytes say how wide frames
// are, what fired, how the sensor is made and moved; the rest are numbers and, at the end, the section. With one bit
// the rest is damage to a valid section instead: a place and a byte, again and again.
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "mask/stream.hpp"
#include "parts/fuzz_geometry.hpp"
#include "parts/fuzz_input.hpp"

using namespace lidarcodec;

namespace {

// What both ends know of a frame.
struct Frame {
  FuzzGeometry any;
  std::vector<std::uint16_t> azimuth, expected;
  MaskView view;

  Frame(std::size_t width, std::uint8_t pattern, std::uint8_t turned, std::uint8_t kind, Numbers& numbers)
      : any(width, pattern, turned, (kind & 1u) != 0), azimuth(2 * width), expected(kMaskRows * width) {
    std::uint32_t at = numbers.next(2);
    for (std::size_t c = 0; c < 2 * width; ++c, at += kind & 2u ? 17 : numbers.next(2))
      azimuth[c] = static_cast<std::uint16_t>(at % (numbers.next(1) == 7 ? 36'001u : 36'000u));
    for (std::size_t i = 0; i < expected.size(); ++i)
      expected[i] = static_cast<std::uint16_t>(kind & 4u     ? numbers.next(2)
                                               : i % 11 == 0 ? 0
                                                             : 2000 + 40 * (i / std::max<std::size_t>(width, 1)));
    view.geometry = any.image;
    view.azimuth = azimuth.data();
    if (kind & 8u) view.expected = expected.data();
    for (std::size_t row = 0; row < kMaskRows; ++row)
      view.vertical[row] = kind & 16u ? static_cast<std::int32_t>(numbers.next(4))
                                      : 4'000'000 - static_cast<std::int32_t>(row) * 700'000;
    if (kind & 32u) {
      for (std::int32_t& r : view.motion.rotation) r = static_cast<std::int32_t>(numbers.next(4));
      for (std::int32_t& t : view.motion.translation) t = static_cast<std::int32_t>(numbers.next(4));
    }
  }
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width = input.below(48);
  const std::uint8_t pattern = input.byte(), turned = input.byte(), kind = input.byte(), holes = input.byte();
  const std::vector<std::uint8_t> rest = input.rest();
  Numbers numbers(rest);
  MaskStream sender(Path::Plain), receiver, hostile;  // on all paths that code differently
  try {
    for (std::uint8_t frame = 0; frame < 3; ++frame) {
      const Frame seen((width + 5u * frame) % 48, pattern, turned, kind, numbers);
      const std::vector<std::uint8_t> mask = seen.any.returns(static_cast<std::uint8_t>(holes + 60 * frame));
      const std::vector<std::uint8_t> coded = sender.encode(mask.data(), seen.view);
      hostile.encode(mask.data(), seen.view);
      if (coded.size() > 1 && receiver.decode(coded.data(), coded.size(), seen.view) != mask) std::abort();
    }
    const Frame seen(width, pattern, turned, kind, numbers);
    if (kind & 64u) {
      std::vector<std::uint8_t> coded = sender.encode(seen.any.returns(holes).data(), seen.view);
      for (std::size_t i = 0; i + 1 < rest.size() && i < 16; i += 2) coded[rest[i] % coded.size()] ^= rest[i + 1];
      hostile.decode(coded.data(), coded.size(), seen.view);
    } else {
      hostile.decode(rest.data(), rest.size(), seen.view);
    }
  } catch (const Error&) {
  }
  return 0;
}
