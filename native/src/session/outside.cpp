#include "session/outside.hpp"

#include <array>

namespace lidarcodec {
namespace {

constexpr std::uint32_t kMagic = 0xFD2FB528;
constexpr std::size_t kHead = 5, kBlockHead = 3, kChecksum = 4;
constexpr unsigned kRepeated = 1;  // type of a block of one byte that is repeated

// The content size that a frame states (RFC 8878, 3.1.1.1), if its blocks end where the data do; else nothing.
std::optional<std::uint64_t> stated_size(Bytes data) {
  if (data.size() < kHead + 1 || little_endian(data, 0, 4) != kMagic) return std::nullopt;
  const std::uint8_t descriptor = data[4];
  const bool single = (descriptor >> 5 & 1) != 0, has_checksum = (descriptor & 4) != 0;
  const std::size_t bytes = std::array<std::size_t, 4>{single ? 1u : 0u, 2, 4, 8}[descriptor >> 6];
  std::size_t at = kHead + (single ? 0 : 1);
  if ((descriptor & 3) != 0 || bytes == 0 || data.size() < at + bytes) return std::nullopt;  // a dictionary, or no size
  const std::uint64_t size = little_endian(data, at, bytes) + (bytes == 2 ? 256 : 0);
  at += bytes;
  for (bool last = false; !last;) {
    if (data.size() - at < kBlockHead) return std::nullopt;
    const std::uint64_t head = little_endian(data, at, kBlockHead);
    last = (head & 1) != 0;
    const std::uint64_t length = kBlockHead + ((head >> 1 & 3) == kRepeated ? 1 : head >> 3);
    if (data.size() - at < length) return std::nullopt;
    at += length;
  }
  if (at + (has_checksum ? kChecksum : 0) != data.size()) return std::nullopt;
  return size;
}

}  // namespace

std::optional<std::vector<std::uint16_t>> Outside::picture(const Picture&) const { return std::nullopt; }

std::optional<std::vector<std::uint8_t>> Outside::weights(const std::string&) const { return std::nullopt; }

std::vector<std::uint8_t> zstd_frame(const Outside& outside, Bytes data, std::size_t size) {
  if (stated_size(data) != size)
    throw Error(ErrorCode::Section, "not one zstd frame of " + std::to_string(size) + " bytes");
  std::vector<std::uint8_t> plain(size);
  if (!outside.unzstd(data, plain))
    throw Error(ErrorCode::Section, "a damaged zstd frame, of " + std::to_string(size) + " bytes");
  return plain;
}

std::vector<std::uint16_t> samples_of(const Outside& outside, const Picture& picture) {
  std::optional<std::vector<std::uint16_t>> samples = outside.picture(picture);
  if (!samples || samples->size() != picture.rows * picture.width)
    throw Error(ErrorCode::Section, std::string("a damaged picture of codec ") + name_of(picture.codec));
  return *std::move(samples);
}

}  // namespace lidarcodec
