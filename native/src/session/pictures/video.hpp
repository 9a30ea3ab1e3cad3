// Ranges that are pictures of an H.264 stream, each predicted from the one before (docs/wire-format.md, "h264 and
// h264-log"); in Python lidarcodec/codecs/video.py.
#pragma once
#include <optional>
#include <utility>

#include "session/frames/image_frame.hpp"
#include "session/pictures/turn_canvas.hpp"
#include "session/planes.hpp"

namespace lidarcodec {

// What all pictures from one IDR picture to the next have in common.
struct VideoHead {
  unsigned bits = 0;
  std::uint8_t mapping = 0;
  std::uint32_t top = 0;
  TurnLayout layout;

  bool operator==(const VideoHead&) const = default;
};

// The pictures of a stream.
class Video {
 public:
  // Forgets all pictures.
  void forget() { read_.reset(); }

  // Raises Reference if the picture before the one of a message was not read.
  void check(const Message& message) const;

  // Puts the ranges of a message into the planes of a frame of an HDL-64E. Raises Section.
  void put_ranges(const Message& message, const Outside& outside, const Sensor& sensor, Planes& planes);

  // The same of another sensor, whose frame has planes. Raises Section, Truncated or Reference.
  void put_ranges(const Message& message, const Outside& outside, ImageFrame& frame);

 private:
  std::vector<std::uint16_t> samples(const Message& message, const Outside& outside, const VideoHead& head, Bytes unit);

  VideoHead head_;                     // of the picture that was read last
  std::optional<std::uint64_t> read_;  // index of its frame; nothing after an error
};

}  // namespace lidarcodec
