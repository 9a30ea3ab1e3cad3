#include "predictive/coder.hpp"

#include "base/error.hpp"
#include "mask/align.hpp"
#include "mask/rows.hpp"
#include "predictive/image.hpp"

#include <utility>

namespace lidarcodec {

namespace {

constexpr std::uint8_t kAlone = 1, kExpecting = 2;  // kinds: contexts of this frame only; of what is expected, too
constexpr std::uint8_t kSlab = 2, kQuarters = 8;   // added to either: of a slab; of a whole frame
constexpr std::uint8_t kFree = 4;                  // added to any of those that are written: of free ranges
constexpr std::uint8_t kLearnedKind = 16;          // added to any: a network says what is likely to begin with
constexpr std::uint8_t kOfFirings = 32;            // added to any: firings are counted; others are only read
constexpr std::uint8_t kQuick = 128;               // added to those that count them and have no network: few contexts, own leaves
constexpr std::uint8_t kByLeaf = 192;              // added to those that count them: how many bits of an offset learn depends on the leaf
constexpr std::uint8_t kOffsets = 192;             // bits that are kQuick, kByLeaf or 0; ranges with 0 are only read, others are unknown

// Whether a kind is one of free ranges.
bool is_free(std::uint8_t kind) {
  constexpr unsigned kRounded = 1u << (kAlone + kSlab) | 1u << (kExpecting + kSlab) | 1u << (kAlone + kQuarters) | 1u << (kExpecting + kQuarters);
  return (kRounded << kFree >> (kind & 15) & 1u) != 0;
}

// Bytes before the streams: kind, turn u16, firing u8 where they are counted, bytes of each stream but the last u32; of a
// slab also known u8.
std::size_t sizes_at(bool counted) { return counted ? 4 : 3; }
std::size_t head_bytes(std::size_t parts, bool slab, bool counted) { return sizes_at(counted) + 4 * (parts - 1) + (slab ? 1 : 0); }
std::size_t parts_of(bool slab) { return slab ? kSlabParts : kMostParts; }

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

// Of frames as they are written now: they count firings.
std::uint8_t kind_of(bool slab, const std::uint16_t* expected, const RiddleNet* net, RangeKind kind, bool free) {
  return static_cast<std::uint8_t>((expected == nullptr ? kAlone : kExpecting) + (slab ? kSlab : kQuarters) + (free ? kFree : 0) +
                                   (net != nullptr ? kLearnedKind : 0) + kOfFirings +
                                   (kind == RangeKind::Quick ? kQuick : kind == RangeKind::Full ? kByLeaf : 0));
}

// Firing of column 0 of an image, from that of the first column behind those that are known.
std::uint32_t firing_of_first(std::uint32_t firing, std::size_t past) {
  if (firing == kNotCounted) return kNotCounted;
  return (firing + kFirings - static_cast<std::uint32_t>(past % kFirings)) % kFirings;
}

// Returns that are to be coded: behind the known columns.
std::size_t returns_behind(const ClosedRows& returned, const std::uint8_t* returns, std::size_t width, std::size_t known) {
  std::size_t before = 0;
  for (std::size_t row = 0; row < kMaskRows && known != 0; ++row)
    for (std::size_t column = 0; column < known; ++column) before += returns[row * width + column] != 0;
  return returned.returns - before;
}

}  // namespace

KnownColumns known_columns(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return kWholeFrame;
  const int kind = (data[0] & 15) - (is_free(data[0]) ? kFree : 0);
  if (kind != kAlone + kSlab && kind != kExpecting + kSlab) return kWholeFrame;
  const std::size_t head = head_bytes(kSlabParts, true, (data[0] & kOfFirings) != 0);
  if (size < head) throw Error(ErrorCode::Truncated, "ranges end within their header", size);
  return data[head - 1];
}

PredictiveCoder::PredictiveCoder(Path path, std::shared_ptr<const RiddleNets> nets)
    : path_(path), nets_(std::move(nets)), model_(nets_ != nullptr), states_(std::make_unique<SlabStates>()) {}
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
  SlabStates states;
  PredictiveParts<WideEncoder> parts;
  write_image({quickest_path(), model, {nullptr, &samples}, states, false, RangeKind::Full},
              {layout, returned, cells, expected, geometry.width, 0, turn, 0}, parts, ranges);
}

void PredictiveCoder::change(std::shared_ptr<const RiddleNets> nets) {
  if ((nets == nullptr) != (nets_ == nullptr)) throw Error(ErrorCode::Section, "networks in the middle of a stream without");
  nets_ = std::move(nets);
}

void PredictiveCoder::reset() {
  model_.reset();
  *states_ = {};
}

std::vector<std::uint8_t> PredictiveCoder::encode(const std::uint16_t* ranges, const std::uint8_t* returns,
                                                  const RangeCells& whole, const MaskGeometry& geometry,
                                                  std::uint32_t turn, std::uint32_t firing, const std::uint16_t* expected,
                                                  KnownColumns known, RiddleSamples* samples, bool quick, std::uint16_t* sent) {
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
  const RangeKind kind = quick && net == nullptr ? RangeKind::Quick : RangeKind::Full;
  if (samples != nullptr) samples->inputs = inputs;
  PredictiveParts<WideEncoder> parts;
  write_image({path_, model_, {net, samples}, *states_, known >= 0, kind}, {layout, returned, cells, expected, width, past, turn, firing_of_first(firing, past), sent}, parts, ranges);
  const std::size_t count = parts_of(known >= 0);
  std::array<const std::vector<std::uint8_t>*, kMostParts> streams{};
  std::size_t size = head_bytes(count, known >= 0, true);
  for (std::size_t p = 0; p < count; ++p) {
    streams[p] = &parts[p].coder.finish(parts[p].interval);
    size += streams[p]->size();
  }
  std::vector<std::uint8_t> out;
  out.reserve(size);
  put(out, kind_of(known >= 0, expected, net, kind, cells.free), 1);
  put(out, turn, 2);
  put(out, firing, 1);
  for (std::size_t p = 0; p + 1 < count; ++p) put(out, streams[p]->size(), 4);
  if (known >= 0) put(out, past, 1);
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
  for (std::size_t row = 0; row < kMaskRows; ++row) std::copy_n(before + row * past, past, image.begin() + static_cast<std::ptrdiff_t>(row * width));
  if (returns_behind(returned, returns, width, past) == 0) {
    if (size != 0) throw Error(ErrorCode::Section, "ranges where there are no returns");
    return image;
  }
  const bool slab = known >= 0;
  const std::size_t count = parts_of(slab);
  if (size < 1) throw Error(ErrorCode::Truncated, "ranges end within their header", size);
  const RiddleNet* const net = net_of(expected != nullptr);
  const bool counted = (data[0] & kOfFirings) != 0;
  const int offsets = data[0] & kOffsets;
  const RangeKind kind = offsets == kQuick ? RangeKind::Quick : offsets == kByLeaf ? RangeKind::Full : RangeKind::Before;
  RangeCells cells = whole;
  cells.free = is_free(data[0]) && kind != RangeKind::Before && cells.step > 1;
  if ((data[0] | kOfFirings) != kind_of(slab, expected, net, kind, cells.free) || (kind != RangeKind::Before && !counted) ||
      (kind == RangeKind::Quick && net != nullptr))
    throw Error(ErrorCode::Section, "ranges of an unknown kind");
  const std::size_t head = head_bytes(count, slab, counted);
  if (size < head) throw Error(ErrorCode::Truncated, "ranges end within their header", size);
  const auto turn = static_cast<std::uint32_t>(take(data + 1, 2));
  const std::uint32_t firing = counted ? data[3] : kNotCounted;
  if (counted && firing >= kFirings) throw Error(ErrorCode::Section, "a firing that is counted otherwise");
  if (slab && data[head - 1] != past) throw Error(ErrorCode::Section, "a slab behind other columns than are known");
  PredictiveParts<WideDecoder> parts;
  for (std::size_t p = 0, at = head; p < count; ++p) {
    const std::size_t rest = size - at, bytes = p + 1 < count ? take(data + sizes_at(counted) + 4 * p, 4) : rest;
    if (bytes > rest) throw Error(ErrorCode::Truncated, "ranges end before their streams do", size);
    parts[p] = PredictivePart<WideDecoder>{WideDecoder(data + at, bytes)};
    parts[p].interval = parts[p].coder.start();
    at += bytes;
  }
  read_image({path_, model_, {net, nullptr}, *states_, slab, kind}, {layout, returned, cells, expected, width, past, turn, firing_of_first(firing, past)}, parts, image.data());
  for (std::size_t p = 0; p < count; ++p) parts[p].coder.finish(parts[p].interval);
  return image;
}

}  // namespace lidarcodec
