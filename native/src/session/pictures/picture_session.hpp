// A session that reads ranges of all codecs of pictures, by a decoder of their pictures from outside: jxl, jpeg,
// jpeg-layered, h264, h264-log. Its `Outside` says of which codecs it has one, by `reads_ranges`. Messages of
// jpeg-layered have several frames.
#pragma once
#include "session/pictures/video.hpp"
#include "session/session.hpp"

namespace lidarcodec {

class PictureSession {
 public:
  explicit PictureSession(std::unique_ptr<const Outside> outside) : outside_(*outside), session_(std::move(outside)) {}

  // The frames of a message, one at least, as `Session::push`. They hold until the next call.
  const std::vector<SessionFrame>& push(Bytes message);

 private:
  std::vector<SessionFrame> decoded(const Message& message);
  SessionFrame alone(const Message& message);
  std::vector<SessionFrame> together(const Message& message);
  std::vector<SessionFrame> others_together(const Message& message);

  const Outside& outside_;
  Session session_;
  Video video_;
  std::optional<std::tuple<Codec, std::uint64_t, bool>> of_;  // codec and stream of the message before
  std::vector<SessionFrame> frames_;
};

}  // namespace lidarcodec
