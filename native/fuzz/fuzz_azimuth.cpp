// Any bytes as an azimuth section, and any rotations there and back.
#include <cstdlib>

#include "base/error.hpp"
#include "parts/fuzz_input.hpp"
#include "planes/azimuth_coder.hpp"

namespace {

void check_round_trip(const lidarcodec::Azimuths& frame, std::size_t width) {
  const std::vector<std::uint8_t> data = lidarcodec::encode_azimuth(frame.azimuth.data(), frame.fired.data(), width);
  const lidarcodec::Azimuths decoded = lidarcodec::decode_azimuth(data.data(), data.size(), width);
  if (decoded.azimuth != frame.azimuth || decoded.fired != frame.fired) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const std::size_t width = input.below(500);
  const std::vector<std::uint8_t> rest = input.rest();
  try {
    check_round_trip(lidarcodec::decode_azimuth(rest.data(), rest.size(), width), width);
  } catch (const lidarcodec::Error&) {
  }
  lidarcodec::Azimuths frame{std::vector<std::uint16_t>(2 * width), std::vector<std::uint8_t>(2 * width)};
  for (std::size_t column = 0; column < width; ++column) {
    const std::uint8_t fired = input.byte();
    frame.fired[column] = fired & 1u;
    frame.fired[width + column] = fired >> 1 & 1u;
    frame.azimuth[column] = static_cast<std::uint16_t>(input.below(36000));
    frame.azimuth[width + column] =
        (fired & 3u) == 3 && fired & 4u ? static_cast<std::uint16_t>(input.below(36000)) : frame.azimuth[column];
  }
  check_round_trip(frame, width);
  return 0;
}
