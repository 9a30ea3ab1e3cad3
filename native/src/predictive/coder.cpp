#include "predictive/coder.hpp"

#include <utility>

#include "base/beside.hpp"
#include "base/error.hpp"
#include "mask/align.hpp"
#include "mask/rows.hpp"
#include "predictive/image.hpp"
#include "predictive/kind.hpp"

namespace lidarcodec {

namespace {

// The header: kind u8, turn u16, firing u8, the size of each stream but the last u32; of a slab also known u8.
constexpr std::size_t kSizesAt = 4;  // offset of the sizes of streams
std::size_t streams_of(const RangeKind& kind) {
  return kind.slab ? kSlabParts : kind.halves ? 2 * kMostParts : kMostParts;
}
std::size_t head_bytes(const RangeKind& kind) { return kSizesAt + 4 * (streams_of(kind) - 1) + (kind.slab ? 1 : 0); }

constexpr RowSpan kUpperRows{0, kMaskRows / 2}, kLowerRows{kMaskRows / 2, kMaskRows};
// Returns of a frame for whose halves a thread pays: coding them takes thirty times as long as starting one.
constexpr std::size_t kWorthAThread = 16'384;

void check(const RangeCells& cells, const MaskGeometry& geometry, KnownColumns known) {
  if (known < kWholeFrame || known > std::min<KnownColumns>(255, static_cast<KnownColumns>(geometry.width)))
    throw Error(ErrorCode::Section, "more known columns than there are");
  if (cells.step % 2 == 0 || cells.step > 65535) throw Error(ErrorCode::Section, "a step that is not odd, or too long");
  for (const std::int32_t level : cells.level)
    if (level < 0 || level > kMaxLevel) throw Error(ErrorCode::Section, "a row's level beyond the limits");
}

void put(std::vector<std::uint8_t>& out, std::size_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

std::size_t take(const std::uint8_t* from, int bytes) {
  std::size_t value = 0;
  for (int i = bytes - 1; i >= 0; --i) value = value << 8 | from[i];
  return value;
}

// The firing of column 0 of an image; firing: that of the first column after `past` known ones.
std::uint32_t firing_of_first(std::uint32_t firing, std::size_t past) {
  return (firing + kFirings - static_cast<std::uint32_t>(past % kFirings)) % kFirings;
}

// The number of returns after the known columns: those that are coded.
std::size_t returns_behind(const ClosedRows& returned, const std::uint8_t* returns, std::size_t width,
                           std::size_t known) {
  std::size_t before = 0;
  for (std::size_t row = 0; row < kMaskRows && known != 0; ++row)
    for (std::size_t column = 0; column < known; ++column) before += returns[row * width + column] != 0;
  return returned.returns - before;
}

}  // namespace

KnownColumns known_columns(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return kWholeFrame;
  if (!RangeKind::is_known(data[0]) || !RangeKind::of(data[0]).slab)
    return kWholeFrame;  // `decode` refuses unknown kinds
  const std::size_t head = head_bytes(RangeKind::of(data[0]));
  if (size < head) throw Error(ErrorCode::Truncated, "ranges end within their header", size);
  return data[head - 1];
}

PredictiveCoder::PredictiveCoder(Path path, std::shared_ptr<const RiddleNets> nets, std::optional<bool> at_once)
    : path_(path),
      nets_(std::move(nets)),
      at_once_(at_once),
      model_(nets_ != nullptr),
      slab_ends_(std::make_unique<SlabEnds>()) {}
PredictiveCoder::PredictiveCoder(const PredictiveCoder& other)
    : path_(other.path_),
      nets_(other.nets_),
      at_once_(other.at_once_),
      model_(other.model_),
      lower_(other.lower_ == nullptr ? nullptr : std::make_unique<PredictiveModel>(*other.lower_)),
      slab_ends_(std::make_unique<SlabEnds>(*other.slab_ends_)) {}
PredictiveCoder::~PredictiveCoder() = default;

const RiddleNet* PredictiveCoder::net_of(bool expects) const {
  if (nets_ == nullptr) return nullptr;
  const std::optional<RiddleNet>& net = expects ? nets_->expecting : nets_->alone;
  if (!net) throw Error(ErrorCode::Section, "weights without a network for frames of this kind");
  return &*net;
}

void PredictiveCoder::sample(const std::uint16_t* ranges, const std::uint8_t* returns, const RangeCells& cells,
                             const MaskGeometry& geometry, std::uint32_t turn, const std::uint16_t* expected,
                             RiddleSamples& samples) {
  check(cells, geometry, kWholeFrame);
  if (turn > 65535) throw Error(ErrorCode::Section, "a turn of more than 65535 columns");
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, geometry.width);
  samples.inputs = expected != nullptr ? kInputsExpecting : kInputsAlone;
  if (returned.returns == 0) return;
  if (turn == 0) turn = find_turn(layout, returned.cells.data(), geometry.width);
  PredictiveModel model(true);
  SlabEnds states;
  PredictiveParts<WideEncoder> parts;
  write_image({quickest_path(), model, {nullptr, &samples}, states, false, false},
              {layout, returned, cells, expected, geometry.width, 0, turn, 0}, parts, ranges);
}

void PredictiveCoder::change(std::shared_ptr<const RiddleNets> nets) {
  if ((nets == nullptr) != (nets_ == nullptr))
    throw Error(ErrorCode::Section, "networks cannot be switched on or off in the middle of a stream");
  nets_ = std::move(nets);
}

void PredictiveCoder::reset() {
  model_.reset();
  lower_.reset();
  *slab_ends_ = {};
}

bool PredictiveCoder::at_once(std::size_t returns) const {
  return at_once_ ? *at_once_ : returns >= kWorthAThread && has_free_processor();
}

template <class Code>
void PredictiveCoder::code_halves(bool halves, bool at_once, const Code& code) {
  if (!halves) {
    lower_.reset();
    return code(0, model_, {});
  }
  if (lower_ == nullptr) lower_ = std::make_unique<PredictiveModel>(model_);
  Beside lower([&] { code(1, *lower_, kLowerRows); }, at_once);
  code(0, model_, kUpperRows);
  lower.get();
}

std::vector<std::uint8_t> PredictiveCoder::encode(const std::uint16_t* ranges, const std::uint8_t* returns,
                                                  const RangeCells& whole, const MaskGeometry& geometry,
                                                  std::uint32_t turn, std::uint32_t firing,
                                                  const std::uint16_t* expected, KnownColumns known,
                                                  RiddleSamples* samples, bool quick, std::uint16_t* sent,
                                                  bool halves) {
  check(whole, geometry, known);
  RangeCells cells = whole;
  cells.free = sent != nullptr && cells.step > 1;
  const std::size_t inputs = expected != nullptr ? kInputsExpecting : kInputsAlone;
  if (samples != nullptr && samples->size() != 0 && samples->inputs != inputs)
    throw Error(ErrorCode::Section, "samples of frames of two kinds");
  if (turn > 65535) throw Error(ErrorCode::Section, "a turn of more than 65535 columns");
  firing %= kFirings;
  const std::size_t width = geometry.width, past = known < 0 ? 0 : static_cast<std::size_t>(known);
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, width);
  if (returns_behind(returned, returns, width, past) == 0) return {};
  if (turn == 0) turn = find_turn(layout, returned.cells.data(), width);
  const RiddleNet* const net = net_of(expected != nullptr);
  if (net == nullptr) samples = nullptr;
  const RangeKind kind{expected != nullptr,     known >= 0, net != nullptr,
                       quick && net == nullptr, cells.free, halves && known < 0};
  if (samples != nullptr) samples->inputs = inputs;
  std::array<PredictiveParts<WideEncoder>, 2> parts;
  const bool apart = kind.halves && samples == nullptr && at_once(returned.returns);  // samples are taken row by row
  code_halves(kind.halves, apart, [&](std::size_t half, PredictiveModel& model, const RowSpan& rows) {
    write_image({path_, model, {net, samples}, *slab_ends_, kind.slab, kind.quick},
                {layout, returned, cells, expected, width, past, turn, firing_of_first(firing, past), sent, rows},
                parts[half], ranges);
  });
  const std::size_t count = streams_of(kind);
  std::array<const std::vector<std::uint8_t>*, 2 * kMostParts> streams{};
  std::size_t size = head_bytes(kind);
  for (std::size_t p = 0; p < count; ++p) {
    PredictivePart<WideEncoder>& part = parts[p / kMostParts][p % kMostParts];
    streams[p] = &part.coder.finish(part.interval);
    size += streams[p]->size();
  }
  std::vector<std::uint8_t> out;
  out.reserve(size);
  put(out, kind.byte(), 1);
  put(out, turn, 2);
  put(out, firing, 1);
  for (std::size_t p = 0; p + 1 < count; ++p) put(out, streams[p]->size(), 4);
  if (kind.slab) put(out, past, 1);
  for (std::size_t p = 0; p < count; ++p) out.insert(out.end(), streams[p]->begin(), streams[p]->end());
  return out;
}

std::vector<std::uint16_t> PredictiveCoder::decode(const std::uint8_t* data, std::size_t size,
                                                   const std::uint8_t* returns, const RangeCells& whole,
                                                   const MaskGeometry& geometry, const std::uint16_t* expected,
                                                   KnownColumns known, const std::uint16_t* before) {
  check(whole, geometry, known);
  const std::size_t width = geometry.width, past = known < 0 ? 0 : static_cast<std::size_t>(known);
  const MaskLayout layout(geometry);
  const ClosedRows returned(returns, layout, width);
  std::vector<std::uint16_t> image(kMaskRows * width);
  for (std::size_t row = 0; row < kMaskRows; ++row)
    std::copy_n(before + row * past, past, image.begin() + static_cast<std::ptrdiff_t>(row * width));
  if (returns_behind(returned, returns, width, past) == 0) {
    if (size != 0) throw Error(ErrorCode::Section, "ranges where there are no returns");
    return image;
  }
  const bool slab = known >= 0;
  if (size < 1) throw Error(ErrorCode::Truncated, "ranges end within their header", size);
  const RiddleNet* const net = net_of(expected != nullptr);
  const RangeKind kind = RangeKind::of(data[0]);
  RangeCells cells = whole;
  cells.free = kind.free;
  if (!RangeKind::is_known(data[0]) || kind.expected != (expected != nullptr) || kind.slab != slab ||
      kind.network != (net != nullptr) || (kind.free && cells.step == 1))
    throw Error(ErrorCode::Section, "ranges of an unknown kind");
  const std::size_t count = streams_of(kind), head = head_bytes(kind);
  if (size < head) throw Error(ErrorCode::Truncated, "ranges end within their header", size);
  const auto turn = static_cast<std::uint32_t>(take(data + 1, 2));
  const std::uint32_t firing = data[3];
  if (firing >= kFirings) throw Error(ErrorCode::Section, "the count of firings goes beyond its period");
  if (slab && data[head - 1] != past)
    throw Error(ErrorCode::Section, "this part of a turn follows columns that were not decoded");
  std::array<PredictiveParts<WideDecoder>, 2> parts;
  const auto part = [&](std::size_t p) -> PredictivePart<WideDecoder>& {
    return parts[p / kMostParts][p % kMostParts];
  };
  for (std::size_t p = 0, at = head; p < count; ++p) {
    const std::size_t rest = size - at, bytes = p + 1 < count ? take(data + kSizesAt + 4 * p, 4) : rest;
    if (bytes > rest) throw Error(ErrorCode::Truncated, "ranges end before their streams do", size);
    part(p) = PredictivePart<WideDecoder>{WideDecoder(data + at, bytes)};
    part(p).interval = part(p).coder.start();
    at += bytes;
  }
  const bool apart = kind.halves && at_once(returned.returns);
  code_halves(kind.halves, apart, [&](std::size_t half, PredictiveModel& model, const RowSpan& rows) {
    read_image({path_, model, {net, nullptr}, *slab_ends_, slab, kind.quick},
               {layout, returned, cells, expected, width, past, turn, firing_of_first(firing, past), nullptr, rows},
               parts[half], image.data());
  });
  for (std::size_t p = 0; p < count; ++p) part(p).coder.finish(part(p).interval);
  return image;
}

}  // namespace lidarcodec
