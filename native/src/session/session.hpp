// Decoder of one stream: bytes of messages in, planes of frames out. The same for every program that embeds the core;
// what each of them has of its own is given from outside. The format is docs/wire-format.md.
//
// Frames of an HDL-64E and of other sensors come out apart: `planes` and `images`.
//
// Decoded here: raw, zstd, pcodec, riddle, predictive; where there is a decoder of their pictures png, and jxl of other
// sensors than an HDL-64E. Of codecs whose ranges are read elsewhere, by the program or by
// pictures/picture_session.hpp, all else is decoded. Other codecs are refused by name.
#pragma once
#include <array>
#include <memory>
#include <optional>
#include <tuple>

#include "session/frames/image_frame.hpp"
#include "session/kept.hpp"
#include "session/planes.hpp"
#include "session/sensor.hpp"
#include "session/shelf.hpp"

namespace lidarcodec {

struct SessionFrame {
  Codec codec{};
  std::uint64_t stream_id = 0, index = 0;
  std::int64_t stamp_ns = 0;  // host time of the first packet, since 1970 UTC
  bool key = false;
  std::shared_ptr<const Sensor> sensor;  // an HDL-64E; nothing if it is another sensor
  Planes planes;                         // of an HDL-64E; of a thinned frame in its own columns
  std::optional<ImageFrame> images;      // of another sensor
  bool has_intensity = false;
  std::optional<std::array<double, 12>> pose;  // T_world_sensor, the first three rows
};

class Session {
 public:
  explicit Session(std::unique_ptr<const Outside> outside) : outside_(std::move(outside)) {}

  // The frame of a message. It holds until the next call. Raises Header, Version, Truncated, Checksum, Section, or
  // Reference where a key message has to come first; then goes on with the next message.
  const SessionFrame& push(Bytes message);

  // The same for a message that was read elsewhere; a thinned frame in the columns that were sent, with ranges of 0
  // where they are read elsewhere.
  SessionFrame decode(const Message& message);

  // Forgets what another stream, or another codec, has brought than that of a message; `decode` does so by itself.
  void begin_stream(const Message& message);

  // Puts such a frame of an HDL-64E into the columns that it had before it was thinned. Raises Section or Truncated.
  void put_in_own_columns(const Message& message, SessionFrame& frame) const;

  // Refuses messages that need another until one that needs none is decoded: the program could not use the last frame.
  void cut() { last_.reset(); }

  // Takes a CALIBRATION section that a message of the stream brought before this session began: else the stream could
  // not be decoded before its next key message. Raises Section.
  void give_calibration(Bytes section);

  // Name of weights that a message needs and that are not here yet, as far as the message says so: "" if there are
  // none. Where weights can be had, but take their time, ask before `push`, and have `Outside::weights` give them then.
  std::string missing_weights(Bytes message) const;

 private:
  ImageFrame images_of(const Message& message);
  void refer(const Message& message);
  void decode_planes_of(const Message& message, SessionFrame& frame);
  Planes planes_of(const Message& message, const Sensor& sensor);
  void decode_mask_of(const Message& message, const Sensor& sensor, Planes& planes);
  const std::vector<std::uint16_t>* expected(const Message& message, const Sensor& sensor, const Planes& planes);
  void decode_ranges(const Message& message, const Sensor& sensor, Planes& planes);
  void decode_slab(Bytes coded, const RangeCells& cells, std::size_t before, const std::vector<std::uint16_t>* expected,
                   const Sensor& sensor, Planes& planes);
  void use_networks(const Message& message, std::uint8_t effort, const std::string& name);

  std::unique_ptr<const Outside> outside_;
  SessionFrame frame_;

  // Codec and stream of what follows, and whether it is of another sensor than an HDL-64E.
  std::optional<std::tuple<Codec, std::uint64_t, bool>> of_;
  SensorBook sensors_;
  DescribedSensorBook described_;
  Shelf shelf_;
  std::optional<std::uint64_t> last_;  // index of the frame that was decoded last, if others may need it
  Remembered now_;                     // after that frame
  KeptFrames kept_;                    // after frames before it
  IntensityMemory intensities_;        // of the parts of a turn, in codecs that expect no ranges
  std::optional<std::uint64_t> part_;  // index of the frame after which that is, if it was decoded

  std::shared_ptr<PlaneMemory> plane_memory_;           // of other sensors than an HDL-64E
  Motion motion_;                                       // of the message at hand
  std::optional<std::vector<std::uint16_t>> expected_;  // (64, W), of the message at hand, once it is asked for
};

}  // namespace lidarcodec
