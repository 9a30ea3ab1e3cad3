// What a session is given from outside: decompression, pictures and weights, of which each program that embeds the core
// has its own. An answer is checked as bytes of a message are.
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "base/bytes.hpp"
#include "session/message.hpp"

namespace lidarcodec {

struct DecodedCloud;  // session/frames/cloud_section.hpp

// A picture of a message, of one channel. begins: of a video, whether it refers to no picture before.
struct Picture {
  Codec codec{};
  Bytes data;
  std::size_t rows = 0, width = 0;
  unsigned bits = 16;
  bool begins = true;
};

class Outside {
 public:
  virtual ~Outside() = default;

  // Decompresses one zstd frame that says it holds as many bytes as `plain` has. Whether it did.
  virtual bool unzstd(Bytes frame, std::span<std::uint8_t> plain) const = 0;
  // The bytes of one zlib stream, `most` of them at most; nothing if it is damaged or holds more.
  virtual std::optional<std::vector<std::uint8_t>> inflated(Bytes stream, std::size_t most) const = 0;
  // Whether it opens pictures of 16 bits, png or jxl; by default none.
  virtual bool opens_pictures(Codec) const { return false; }
  // Whether the ranges of a codec are read elsewhere, from the planes that the session gives; by default of none.
  // planes: of frames of another sensor than an HDL-64E
  virtual bool reads_ranges(Codec, [[maybe_unused]] bool planes) const { return false; }
  // The message of a CLOUD section, by `decode_cloud`; nothing where the program reads the section by itself.
  virtual std::shared_ptr<const DecodedCloud> cloud(Bytes section) const = 0;
  // Whether the program takes frames of a sensor that this core does not know: it then checks their layout and series,
  // and finds the directions of their columns; by default it does not, and such messages are refused.
  virtual bool takes_model(const std::string&) const { return false; }
  // The samples of a picture, row after row; nothing if it is damaged or has other sides.
  virtual std::optional<std::vector<std::uint16_t>> picture(const Picture& picture) const;
  // The weight file of a name, 16 hex digits, that no message has brought; by default none is known.
  virtual std::optional<std::vector<std::uint8_t>> weights(const std::string& name) const;
};

// The `size` bytes of data that are one zstd frame and nothing else. The size that it states is looked at before memory
// is taken. Raises Section.
std::vector<std::uint8_t> zstd_frame(const Outside& outside, Bytes data, std::size_t size);

// The rows x width samples of a picture. Raises Section.
std::vector<std::uint16_t> samples_of(const Outside& outside, const Picture& picture);

}  // namespace lidarcodec
