// Pictures of codec png (docs/wire-format.md, "png"): grey, 16 bits, filters none and sub, by the zlib of the system.
#pragma once
#include <zlib.h>

#include <algorithm>
#include <array>
#include <string_view>

#include "session/outside.hpp"

namespace lidarcodec {

// The zlib stream in the parts of a PNG of these sides; nothing if it is anything but that.
inline std::optional<std::vector<std::uint8_t>> png_stream(const Picture& picture) {
  constexpr std::array<std::uint8_t, 8> kSignature = {137, 80, 78, 71, 13, 10, 26, 10};
  constexpr std::array<std::uint8_t, 5> kGrey = {16, 0, 0, 0, 0};
  constexpr std::size_t kAround = 12, kHeaderBytes = 13;  // of a part: its length, name and checksum
  Bytes data = picture.data;
  if (data.size() < kSignature.size() || !std::equal(kSignature.begin(), kSignature.end(), data.begin()))
    return std::nullopt;
  data = data.subspan(kSignature.size());
  const auto number = [&](std::size_t at) {
    return std::uint32_t{data[at]} << 24 | std::uint32_t{data[at + 1]} << 16 | std::uint32_t{data[at + 2]} << 8 |
           data[at + 3];
  };
  std::vector<std::uint8_t> stream;
  for (bool first = true, last = false; !last; first = false) {
    if (data.size() < kAround || number(0) > data.size() - kAround) return std::nullopt;
    const std::size_t size = number(0);
    const std::string_view name(reinterpret_cast<const char*>(data.data()) + 4, 4);
    if (crc32(0, data.data() + 4, static_cast<uInt>(size + 4)) != number(size + 8)) return std::nullopt;
    const Bytes body = data.subspan(8, size);
    if (first) {
      if (name != "IHDR" || size != kHeaderBytes || number(8) != picture.width || number(12) != picture.rows ||
          !std::equal(kGrey.begin(), kGrey.end(), body.begin() + 8))
        return std::nullopt;
    } else if (name == "IDAT") {
      stream.insert(stream.end(), body.begin(), body.end());
    } else if (name != "IEND" || size != 0) {
      return std::nullopt;
    }
    last = name == "IEND";
    data = data.subspan(kAround + size);
  }
  return data.empty() ? std::optional(std::move(stream)) : std::nullopt;
}

// The samples of a PNG; nothing if it is damaged, or anything but that.
inline std::optional<std::vector<std::uint16_t>> png_samples(const Picture& picture, const Outside& outside) {
  const std::optional<std::vector<std::uint8_t>> stream = png_stream(picture);
  if (!stream) return std::nullopt;
  const std::size_t line = 1 + 2 * picture.width, size = picture.rows * line;
  std::optional<std::vector<std::uint8_t>> lines = outside.inflated(*stream, size);
  if (!lines || lines->size() != size) return std::nullopt;
  std::vector<std::uint16_t> samples;
  samples.reserve(picture.rows * picture.width);
  for (std::uint8_t* at = lines->data(); at != lines->data() + size; at += line) {
    if (at[0] > 1) return std::nullopt;
    for (std::size_t i = 3; at[0] == 1 && i < line; ++i) at[i] = static_cast<std::uint8_t>(at[i] + at[i - 2]);
    for (std::size_t i = 1; i < line; i += 2) samples.push_back(static_cast<std::uint16_t>(at[i] << 8 | at[i + 1]));
  }
  return samples;
}

}  // namespace lidarcodec
