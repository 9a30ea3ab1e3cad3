// libFuzzer: any payloads must come back, and any parts must either fit or be refused.
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "base/error.hpp"
#include "packets/assembly.hpp"

namespace lc = lidarcodec;

namespace {

lc::RingOfLaser identity() {
  lc::RingOfLaser ring;
  for (std::size_t i = 0; i < ring.size(); ++i) ring[i] = static_cast<std::uint8_t>(i);
  return ring;
}

lc::Images images_of(const lc::Assembled& a) {
  return {a.width,
          a.range.data(),
          a.intensity.data(),
          a.azimuth.data(),
          a.fired.data(),
          a.layout.size(),
          a.layouts.size() / lc::kBlocks,
          a.layouts.data(),
          a.layout.data(),
          a.irregular.size() / lc::kBlockBytes,
          a.irregular.data(),
          a.second.size() / lc::kBlockReturnBytes,
          a.second.data(),
          a.gps_us.data(),
          a.status.data()};
}

// Payloads whose block heads come from the input, so that layouts of every kind are reached quickly.
std::vector<std::uint8_t> payloads_from(const std::uint8_t* data, std::size_t size) {
  const std::size_t heads = size / 2, packets = std::min<std::size_t>(heads / lc::kBlocks, 8);
  std::vector<std::uint8_t> out(packets * lc::kPacketBytes, 0x5A);
  static const std::uint8_t flags[4][2] = {{0xFF, 0xEE}, {0xFF, 0xDD}, {0xFF, 0xEE}, {0xAB, 0xCD}};
  for (std::size_t i = 0; i < packets * lc::kBlocks; ++i) {
    std::uint8_t* block = out.data() + (i / lc::kBlocks) * lc::kPacketBytes + (i % lc::kBlocks) * lc::kBlockBytes;
    std::memcpy(block, flags[data[2 * i] & 3], 2);
    const unsigned azimuth = (data[2 * i] >> 2 & 15) * 9u + (data[2 * i + 1] & 1 ? 35982u : 0u);
    block[2] = static_cast<std::uint8_t>(azimuth & 0xFF);
    block[3] = static_cast<std::uint8_t>(azimuth >> 8);
    block[4] = data[2 * i + 1];
  }
  return out;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const lc::RingOfLaser ring = identity();
  const bool crafted = data[0] & 1;
  const std::vector<std::uint8_t> payloads =
      crafted ? payloads_from(data + 1, size - 1) : std::vector<std::uint8_t>(data + 1, data + size);
  try {
    lc::Assembled a = lc::assemble(payloads.data(), payloads.size(), ring);
    if (lc::disassemble(images_of(a), ring) != payloads) std::abort();
    // Parts that contradict each other: bend what the wire could bend, then put together again.
    const std::size_t n = std::min<std::size_t>(size - 1, 64);
    for (std::size_t i = 0; i + 1 < n; i += 2) {
      const std::uint8_t at = data[1 + i], to = data[2 + i];
      if (!a.layouts.empty()) a.layouts[at % a.layouts.size()] = to % 8;
      if (!a.layout.empty()) a.layout[at % a.layout.size()] = static_cast<std::uint16_t>(to % 4);
      if (!a.fired.empty() && (to & 0x80)) a.fired[at % a.fired.size()] = to & 1;
    }
    try {
      (void)lc::disassemble(images_of(a), ring);
    } catch (const lc::Error&) {
    }
  } catch (const lc::Error&) {
  }
  return 0;
}
