#include "session/session.hpp"

#include <algorithm>

#include "base/beside.hpp"
#include "base/processor.hpp"
#include "base/sha256.hpp"
#include "planes/azimuth_coder.hpp"
#include "planes/keep_coder.hpp"
#include "session/frames/picture_ranges.hpp"
#include "session/lattice.hpp"
#include "session/ranges.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kReturnsPerByte = 128;  // most returns for a byte of a message of riddle
constexpr std::size_t kNameBytes = 8;
constexpr std::uint8_t kPlainEffort = 1, kMostEffort = 4;
constexpr std::uint8_t kSparseKeep = 4, kSparseKeepAfter = 5;

// Bytes of intensities for which a thread pays: decoding them takes ten times as long as starting one.
constexpr std::size_t kWorthAThread = 4096;

constexpr std::uint8_t kDescribed = 3;  // form of a CALIBRATION section, of other sensors than an HDL-64E

bool expects_ranges(Codec codec) { return codec == Codec::Predictive || codec == Codec::Riddle; }

// All codecs but these send ranges as pictures.
bool has_no_picture(Codec codec) {
  return codec == Codec::Raw || codec == Codec::Zstd || codec == Codec::Pcodec || expects_ranges(codec);
}

void check_codec(const Message& message, const Outside& outside) {
  const Codec codec = message.codec;
  if (has_no_picture(codec) || outside.reads_ranges(codec, message.planes)) return;
  const std::string name = name_of(codec);
  if (name.empty())
    throw Error(ErrorCode::Version, "this build does not know codec " + std::to_string(static_cast<unsigned>(codec)),
                12);
  const bool is_exact = codec == Codec::Png || (message.planes && is_exact_picture(codec));
  if (!is_exact || !outside.opens_pictures(codec))
    throw Error(ErrorCode::Version, "codec " + name + " needs a decoder of pictures, and none was given", 12);
}

Columns columns_of(const Planes& planes) { return {planes.width, planes.azimuth.data(), planes.fired.data()}; }

// Effort and name of the weights, in front of ranges of riddle.
struct RiddleHead {
  std::uint8_t effort;
  std::string name;
};

RiddleHead riddle_head(Bytes coded) {
  if (coded.size() < 1 + kNameBytes) throw Error(ErrorCode::Truncated, "ranges end within their header", coded.size());
  if (coded[0] < kPlainEffort || coded[0] > kMostEffort)
    throw Error(ErrorCode::Section, "ranges of effort " + std::to_string(coded[0]) + ": 1 to 4 are known");
  return {coded[0], hex(coded.subspan(1, kNameBytes))};
}

// Networks of weights for an effort, 2 to 4, as the coder of ranges takes them. Raises Section.
std::shared_ptr<const RiddleNets> nets_of(const WeightFile& weights, std::uint8_t effort) {
  auto nets = std::make_shared<RiddleNets>();
  const auto size = static_cast<std::uint8_t>(effort - 2);
  nets->alone.emplace(weights.network(false, size).given());
  nets->expecting.emplace(weights.network(true, size).given());
  return nets;
}

[[noreturn]] void throw_missing(const Message& message) {
  throw Error(ErrorCode::Reference,
              "frame " + std::to_string(message.frame_index) + " needs frame " + std::to_string(*message.needs) +
                  ", which was not decoded: ask for a key frame",
              *message.needs);
}

}  // namespace

void Session::begin_stream(const Message& message) {
  const std::tuple of(message.codec, message.stream_id, message.planes);
  if (of_ == of) return;
  if (of_) {
    sensors_ = {};
    described_ = {};
    shelf_.forget();
    last_.reset();
    kept_.forget();
  }
  of_.reset();  // until all that the stream needs is here
  now_ = {};
  if (!message.planes && expects_ranges(message.codec)) {
    now_.mask_stream.emplace();
    now_.memory.emplace();
    now_.intensities.emplace();
    now_.coder = std::make_unique<PredictiveCoder>();
  }
  of_ = of;
}

void Session::give_calibration(Bytes section) {
  Message message;
  message.sections.push_back({static_cast<std::uint8_t>(SectionType::Calibration), 0, section});
  if (!section.empty() && section[0] == kDescribed)
    described_.of(message, *outside_);
  else
    sensors_.of(message, *outside_);
}

const SessionFrame& Session::push(Bytes data) {
  const Message message = read_message(data);
  SessionFrame frame = decode(message);
  put_in_own_columns(message, frame);
  frame_ = std::move(frame);
  return frame_;
}

void Session::put_in_own_columns(const Message& message, SessionFrame& frame) const {
  const std::optional<Bytes> lattice = message.planes ? std::nullopt : message.find(SectionType::Lattice);
  if (lattice) frame.planes = in_own_columns(frame.planes, *lattice, *outside_);
}

SessionFrame Session::decode(const Message& message) {
  check_codec(message, *outside_);
  begin_stream(message);
  if (message.frame_count != 1)
    throw Error(ErrorCode::Section,
                "a message of " + std::to_string(message.frame_count) + " frames of a codec that sends one each");
  SessionFrame frame;
  frame.codec = message.codec;
  frame.stream_id = message.stream_id;
  frame.index = message.frame_index;
  frame.stamp_ns = message.stamp_ns;
  frame.key = message.key;
  if (message.planes) {
    frame.images = images_of(message);
    frame.has_intensity = frame.images->plane("intensity") != nullptr;
  } else {
    decode_planes_of(message, frame);
  }
  frame.pose = decode_pose(message);
  return frame;
}

ImageFrame Session::images_of(const Message& message) {
  if (message.codec != Codec::Riddle) return read_image_frame(message, described_, *outside_, nullptr);
  if (message.needs && message.needs != last_) throw_missing(message);
  if (!message.needs) plane_memory_ = empty_plane_memory();
  last_.reset();  // until the message is decoded
  ImageFrame images = read_image_frame(message, described_, *outside_, plane_memory_.get());
  decode_pose(message);
  last_ = message.frame_index;
  return images;
}

// Goes on from the frame that the message needs. Raises Reference if that is not kept.
void Session::refer(const Message& message) {
  if (message.goes_on) {  // takes the place of the part before
    if (message.needs != last_ || message.needs != part_) throw_missing(message);
    last_.reset();  // until it is decoded
  } else if (!message.needs) {
    kept_.forget();
  } else if (message.needs == last_) {
    kept_.put(*last_, Remembered(now_));
  } else {
    std::optional<Remembered> found = kept_.take(*message.needs);
    if (!found) throw_missing(message);
    if (last_) kept_.put(*last_, std::move(now_));
    now_ = Remembered(*found);
    kept_.put(*message.needs, std::move(*found));
    last_.reset();
  }
}

void Session::decode_planes_of(const Message& message, SessionFrame& frame) {
  frame.sensor = sensors_.of(message, *outside_);
  refer(message);
  part_.reset();
  if (!message.goes_on) forget_models(intensities_);
  frame.planes = planes_of(message, *frame.sensor);
  if (message.needs)
    now_.masks.remember(frame.planes.returns, columns_of(frame.planes), frame.sensor->beams.half);
  else
    now_.masks.begin(frame.planes.returns, columns_of(frame.planes), frame.sensor->beams.half);
  last_ = part_ = message.frame_index;
  frame.has_intensity = message.has(SectionType::Intensity);
}

Planes Session::planes_of(const Message& message, const Sensor& sensor) {
  if (message.codec == Codec::Raw) {
    Planes planes = decode_raw(message, sensor);
    check_side(message);
    decode_pose(message);
    return planes;
  }
  if (expects_ranges(message.codec)) {
    last_.reset();  // a message that fails halfway has taught something else than its encoder learned
    expected_.reset();
    motion_ = {};
    if (!message.needs) {
      now_.memory->forget();
      now_.mask_stream->forget();
      *now_.intensities = {};
      now_.coder->reset();
    }
  }
  const Bytes coded = message.section(SectionType::Azimuth);
  Azimuths azimuths = decode_azimuth(coded.data(), coded.size(), message.width);
  Planes planes;
  planes.width = message.width;
  planes.azimuth = std::move(azimuths.azimuth);
  planes.fired = std::move(azimuths.fired);
  decode_mask_of(message, sensor, planes);
  const IntensitySection section(message);
  IntensityMemory& memory = now_.intensities ? *now_.intensities : intensities_;
  const bool apart =
      expects_ranges(message.codec) && section.of_returns.size() >= kWorthAThread && has_free_processor();
  Beside intensities([&] { return decode_modelled(section, sensor, planes, memory); }, apart);
  check_side(message);
  decode_pose(message);
  if (expects_ranges(message.codec))
    decode_ranges(message, sensor, planes);
  else if (outside_->reads_ranges(message.codec, false))
    planes.range.resize(planes.returns.size());
  else
    planes.range = decode_quantised(message, *outside_, planes.returns);
  planes.intensity = intensities.get();
  decode_other_intensities(section, *outside_, sensor, planes);
  return planes;
}

void Session::decode_mask_of(const Message& message, const Sensor& sensor, Planes& planes) {
  const bool keep = message.has(SectionType::Keep);
  const Bytes coded = message.section(keep ? SectionType::Keep : SectionType::Mask);
  const std::uint8_t kind = coded.empty() ? 0 : coded[0];
  const MaskGeometry geometry = sensor.geometry(planes.width, planes.fired.data());
  if (expects_ranges(message.codec) && !keep && (kind == kMaskBegins || kind == kMaskGoesOn)) {
    const std::vector<std::uint16_t>* const foreseen = expected(message, sensor, planes);
    MaskView view;
    view.geometry = geometry;
    view.azimuth = planes.azimuth.data();
    view.vertical = sensor.beams.vertical;
    view.expected = foreseen == nullptr ? nullptr : foreseen->data();
    view.motion = motion_;
    planes.returns = now_.mask_stream->decode(coded.data(), coded.size(), view);
    return;
  }
  std::vector<std::uint8_t> before;
  EarlierMask earlier;
  if (message.needs) {
    before = now_.masks.before(columns_of(planes), sensor.beams.half);
    earlier = {before.data(), planes.width};
  }
  planes.returns = keep && (kind == kSparseKeep || kind == kSparseKeepAfter)
                       ? decode_keep(coded.data(), coded.size(), geometry, planes.azimuth.data(), earlier)
                       : decode_mask(coded.data(), coded.size(), geometry, earlier);
}

// What the ranges of the message at hand are expected to be; nullptr without a MOTION section. Raises Section.
const std::vector<std::uint16_t>* Session::expected(const Message& message, const Sensor& sensor,
                                                    const Planes& planes) {
  if (!expected_ && message.has(SectionType::Motion)) {
    const Bytes data = message.section(SectionType::Motion);
    motion_ = now_.memory->motion(data.data(), data.size());
    expected_ = now_.memory->expected(motion_, columns_of(planes), sensor.beams);
  }
  return expected_ ? &*expected_ : nullptr;
}

void Session::decode_ranges(const Message& message, const Sensor& sensor, Planes& planes) {
  const bool learned = message.codec == Codec::Riddle;
  if (learned) {
    const auto returns = static_cast<std::size_t>(
        std::count_if(planes.returns.begin(), planes.returns.end(), [](std::uint8_t r) { return r != 0; }));
    if (message.section_bytes() * kReturnsPerByte < returns)
      throw Error(ErrorCode::Section, "sections of " + std::to_string(message.section_bytes()) + " bytes for " +
                                          std::to_string(returns) + " returns: too few");
    shelf_.take_all(message, *outside_);
  }
  const std::vector<std::uint16_t>* const foreseen = expected(message, sensor, planes);
  auto [step, coded] = split_step(message.section(SectionType::Range));
  const std::optional<RiddleHead> head = learned ? std::optional(riddle_head(coded)) : std::nullopt;
  if (head) coded = coded.subspan(1 + kNameBytes);
  const KnownColumns known = known_columns(coded.data(), coded.size());
  if (known != kWholeFrame) now_.memory->edge(static_cast<std::size_t>(known));  // are they here?
  if (head) use_networks(message, head->effort, head->name);
  const RangeCells cells{step, sensor.level};
  if (known != kWholeFrame) {
    decode_slab(coded, cells, static_cast<std::size_t>(known), foreseen, sensor, planes);
  } else {
    planes.range = now_.coder->decode(coded.data(), coded.size(), planes.returns.data(), cells,
                                      sensor.geometry(planes.width, planes.fired.data()),
                                      foreseen == nullptr ? nullptr : foreseen->data());
    now_.memory->forget_edge();
  }
  now_.memory->remember(planes.range, columns_of(planes), sensor.beams.half, known != kWholeFrame);
}

// Ranges of a slab, with the columns before it as if they were its own.
void Session::decode_slab(Bytes coded, const RangeCells& cells, std::size_t before,
                          const std::vector<std::uint16_t>* expected, const Sensor& sensor, Planes& planes) {
  const std::vector<std::uint16_t> foreseen =
      expected == nullptr ? std::vector<std::uint16_t>(planes.returns.size()) : *expected;
  const Edge edge = now_.memory->edge(before);
  const Edge all =
      edge.and_then({planes.width, {planes.returns.begin(), planes.returns.end()}, foreseen, planes.fired});
  std::vector<std::uint8_t> known(all.ranges.size());
  std::transform(all.ranges.begin(), all.ranges.end(), known.begin(),
                 [](std::uint16_t r) { return std::uint8_t{r != 0}; });
  const std::vector<std::uint16_t> image = now_.coder->decode(
      coded.data(), coded.size(), known.data(), cells, sensor.geometry(all.width, all.fired.data()),
      expected == nullptr ? nullptr : all.expected.data(), static_cast<KnownColumns>(edge.width), edge.ranges.data());
  const Edge own = Edge{all.width, image, all.expected, all.fired}.last(planes.width);
  planes.range = own.ranges;
  now_.memory->keep_edge(own);
}

// Codes with the networks that a message names from now on. What was learned stays where a stream goes on with other
// weights for the same effort. Raises Section or Reference.
void Session::use_networks(const Message& message, std::uint8_t effort, const std::string& name) {
  const UsedNets wanted{effort == kPlainEffort ? "" : name, effort};
  const Shelf::Weights weights = effort == kPlainEffort ? nullptr : shelf_.find(name, message.frame_index, *outside_);
  if (now_.used == wanted) return;
  const std::shared_ptr<const RiddleNets> nets = weights == nullptr ? nullptr : nets_of(*weights, effort);
  const bool goes_on =
      message.needs && nets != nullptr && now_.used && !now_.used->weights.empty() && now_.used->effort == effort;
  if (goes_on)
    now_.coder->change(nets);
  else
    now_.coder = std::make_unique<PredictiveCoder>(quickest_path(), nets);
  now_.used = wanted;
  if (message.needs && !goes_on)
    throw Error(ErrorCode::Section, "the effort is not that of the frame before, on which this one builds");
}

std::string Session::missing_weights(Bytes data) const {
  try {
    const Message message = read_message(data);
    if (message.codec != Codec::Riddle || message.planes) return "";
    const RiddleHead head = riddle_head(split_step(message.section(SectionType::Range)).second);
    const bool same_stream = of_ == std::tuple(message.codec, message.stream_id, message.planes);
    return head.effort == kPlainEffort ? "" : (same_stream ? shelf_ : Shelf()).missing(message, head.name, *outside_);
  } catch (const Error&) {
    return "";  // `push` says what is wrong
  }
}

}  // namespace lidarcodec
