#include "session/pictures/picture_session.hpp"

#include "session/pictures/group.hpp"
#include "session/pictures/sent_cells.hpp"
#include "session/pictures/still.hpp"

namespace lidarcodec {
namespace {

bool is_video(Codec codec) { return codec == Codec::H264 || codec == Codec::H264Log; }

void check_without_planes(const Message& message) {
  if (message.has(SectionType::Range) || message.needs)
    throw Error(ErrorCode::Section, "a picture of a frame without planes");
}

}  // namespace

const std::vector<SessionFrame>& PictureSession::push(Bytes data) {
  const Message message = read_message(data);
  const std::tuple of(message.codec, message.stream_id, message.planes);
  if (of_ != of && name_of(message.codec)[0] != '\0') {  // one that no build knows changes nothing
    video_.forget();
    of_ = of;
  }
  frames_ = decoded(message);
  return frames_;
}

std::vector<SessionFrame> PictureSession::decoded(const Message& message) {
  const bool has_picture = outside_.reads_ranges(message.codec, message.planes);
  if (has_picture) session_.begin_stream(message);
  if (has_picture && message.codec == Codec::JpegLayered)
    return message.planes ? others_together(message) : together(message);
  std::vector<SessionFrame> frames;
  frames.push_back(has_picture ? alone(message) : session_.decode(message));
  session_.put_in_own_columns(message, frames[0]);
  return frames;
}

// A frame whose picture is its own.
SessionFrame PictureSession::alone(const Message& message) {
  Message planes = message;
  if (is_video(message.codec)) {
    if (message.goes_on) throw Error(ErrorCode::Section, "a video of a part of a turn");
    if (!message.planes) video_.check(message);
  }
  if (message.planes || is_video(message.codec)) planes.needs.reset();  // it is the picture that needs another
  SessionFrame frame = session_.decode(planes);
  try {
    if (frame.images && !message.has(SectionType::Planes))
      check_without_planes(message);
    else if (is_video(message.codec))
      frame.images ? video_.put_ranges(message, outside_, *frame.images)
                   : video_.put_ranges(message, outside_, *frame.sensor, frame.planes);
    else
      frame.images ? put_still_ranges(message, outside_, *frame.images)
                   : put_still_ranges(message, outside_, *frame.sensor, frame.planes);
  } catch (...) {
    session_.cut();
    throw;
  }
  return frame;
}

// The frames of a group of an HDL-64E. The mask of each refers to those before it.
std::vector<SessionFrame> PictureSession::together(const Message& message) {
  check_group(message);
  Group group = split_group(message.section(SectionType::Range), message);
  const Section calibration{static_cast<std::uint8_t>(SectionType::Calibration), 0,
                            message.section(SectionType::Calibration)};
  std::vector<std::size_t> widths;
  for (const Message& one : group.alone) widths.push_back(one.width);
  check_layers(group, kRows, widths);
  std::vector<SessionFrame> frames;
  for (Message& one : group.alone) {
    if (!frames.empty()) {
      one.needs = frames.back().index;
      one.key = false;
      one.sections.push_back(calibration);
    }
    frames.push_back(session_.decode(one));
    frames.back().key = message.key;
  }
  std::vector<Planes*> planes;
  for (SessionFrame& frame : frames) planes.push_back(&frame.planes);
  put_group_ranges(group, outside_, planes);
  for (std::size_t number = 0; number < frames.size(); ++number)
    session_.put_in_own_columns(group.alone[number], frames[number]);
  return frames;
}

std::vector<SessionFrame> PictureSession::others_together(const Message& message) {
  check_group(message);
  const auto [bits, head] = split_picture_head(message.section(SectionType::Range));
  Group group = split_group(head, message);
  check_sizes(group);
  const Section calibration{static_cast<std::uint8_t>(SectionType::Calibration), 0,
                            message.section(SectionType::Calibration)};
  std::vector<SessionFrame> frames;
  for (Message& one : group.alone) {
    if (!frames.empty()) one.sections.push_back(calibration);
    frames.push_back(session_.decode(one));
  }
  std::vector<ImageFrame*> images;
  for (SessionFrame& frame : frames) images.push_back(&*frame.images);
  put_group_ranges(group, bits, outside_, images);
  return frames;
}

}  // namespace lidarcodec
