#include "decoder.hpp"

#include <algorithm>
#include <cstring>

#include "planes/azimuth_coder.hpp"
#include "base/error.hpp"
#include "planes/intensity_coder.hpp"
#include "planes/keep_coder.hpp"

namespace lidarcodec::wasm {
namespace {

constexpr std::int32_t kMostLevel = 1000, kLengthsPerLevel = 20'000;

constexpr std::uint32_t kInBytes = 128;   // added to the shift of a layer whose weights are bytes
constexpr std::uint32_t kWithCases = 64;  // and to that of a first layer with biases of cases

// Layer by layer: weights i8 or i16, biases i32, little endian as this machine is.
class LayerReader {
 public:
  explicit LayerReader(Bytes bytes) : left_(bytes) {}

  template <class T>
  std::vector<T> take(std::size_t count) {
    if (left_.size < count * sizeof(T)) throw Error(ErrorCode::Truncated, "weights end before their layers do");
    std::vector<T> values(count);
    std::memcpy(values.data(), left_.data, count * sizeof(T));
    left_ = {left_.data + count * sizeof(T), left_.size - count * sizeof(T)};
    return values;
  }

 private:
  Bytes left_;
};

}  // namespace

void Decoder::sensor(const std::int32_t* rows) {
  const auto at = [&](std::size_t field, std::size_t row) { return rows[field * kRows + row]; };
  std::int64_t nearest = at(3, 0), furthest = at(3, 0);
  for (std::size_t r = 0; r < kRows; ++r) {
    beams_.half[r] = at(0, r) != 0;
    beams_.rotation[r] = at(1, r);
    beams_.vertical[r] = at(2, r);
    beams_.distance[r] = at(3, r);
    beams_.vertical_offset[r] = at(4, r);
    beams_.horizontal_offset[r] = at(5, r);
    nearest = std::min<std::int64_t>(nearest, at(3, r));
    furthest = std::max<std::int64_t>(furthest, at(3, r));
  }
  const auto level = [&](std::int64_t distance) { return (distance - nearest + kLengthsPerLevel / 2) / kLengthsPerLevel; };
  for (std::size_t r = 0; r < kRows; ++r)
    level_[r] = level(furthest) > kMostLevel ? 0 : static_cast<std::int32_t>(level(beams_.distance[r]));
}

MaskGeometry Decoder::geometry() const {
  MaskGeometry geometry;
  geometry.width = width_;
  geometry.fired = fired.data();
  for (std::size_t r = 0; r < kRows; ++r) {
    geometry.half[r] = beams_.half[r];
    geometry.rotation[r] = beams_.rotation[r];
  }
  return geometry;
}

void Decoder::columns(Bytes coded, std::size_t width) {
  if (width > kMostColumns) throw Error(ErrorCode::Header, "a frame of too many columns");
  Azimuths found = decode_azimuth(coded.data, coded.size, width);
  width_ = width;
  azimuth = std::move(found.azimuth);
  fired = std::move(found.fired);
  bright.assign(kRows * width, 0);
  range.assign(kRows * width, 0);
}

MaskView Decoder::view() const {
  MaskView view;
  view.geometry = geometry();
  view.azimuth = azimuth.data();
  view.vertical = beams_.vertical;
  view.expected = expected_.empty() ? nullptr : expected_.data();
  view.motion = motion_;
  return view;
}

void Decoder::mask(Bytes coded, bool keep, Bytes motion, bool follows) {
  if (!follows) {
    memory_.forget();
    stream_.forget();
  }
  motion_ = {};
  expected_.clear();
  if (motion.data != nullptr) {
    motion_ = memory_.motion(motion.data, motion.size);
    expected_ = memory_.expected(motion_, seen(), beams_);
  }
  if (!keep && coded.size > 0 && (coded.data[0] == kMaskBegins || coded.data[0] == kMaskGoesOn)) {
    returns = stream_.decode(coded.data, coded.size, view());
    return;
  }
  std::vector<std::uint8_t> seen_before;
  EarlierMask earlier;
  if (follows) {
    seen_before = masks_.before(seen(), beams_.half);
    earlier = {seen_before.data(), width_};
  }
  const bool sparse = keep && coded.size > 0 && (coded.data[0] == 4 || coded.data[0] == 5);
  returns = sparse ? decode_keep(coded.data, coded.size, geometry(), azimuth.data(), earlier)
                   : decode_mask(coded.data, coded.size, geometry(), earlier);
}

void Decoder::intensity(Bytes coded) { bright = decode_intensity(coded.data, coded.size, returns.data(), geometry()); }

void Decoder::net(Bytes layers, std::size_t first, std::size_t second, std::array<std::uint32_t, kNetLayers> shifts,
                  bool expects) {
  if (first > kMaxHidden || second > kMaxHidden) throw Error(ErrorCode::Section, "hidden layers of too many values");
  const std::array<std::size_t, kNetLayers + 1> sizes = {expects ? kInputsExpecting : kInputsAlone, first, second, kNetOutputs};
  LayerReader reader(layers);
  std::array<std::vector<std::int16_t>, kNetLayers> weights;
  std::array<std::vector<std::int32_t>, kNetLayers> bias;
  std::vector<std::int8_t> cases;
  std::array<GivenLayer, kNetLayers> given;
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    const std::size_t count = sizes[l] * sizes[l + 1];
    if ((shifts[l] & kInBytes) != 0) {
      const std::vector<std::int8_t> bytes = reader.take<std::int8_t>(count);
      weights[l].assign(bytes.begin(), bytes.end());
    } else {
      weights[l] = reader.take<std::int16_t>(count);
    }
    bias[l] = reader.take<std::int32_t>(sizes[l + 1]);
    const std::uint32_t flags = kInBytes | (l == 0 ? kWithCases : 0);
    given[l] = {sizes[l], sizes[l + 1], weights[l].data(), bias[l].data(), shifts[l] & ~flags};
    if ((shifts[l] & flags & kWithCases) != 0) {
      cases = reader.take<std::int8_t>(kConditionalBiases * first);
      given[l].conditional_bias = cases.data();
    }
  }
  (expects ? nets_->expecting : nets_->alone).emplace(given);
}

void Decoder::use_nets(bool learned) {
  coder_ = std::make_unique<PredictiveCoder>(quickest_path(), learned ? nets_ : nullptr);
}

void Decoder::ranges(Bytes coded, std::uint32_t step, bool follows) {
  if (!follows) coder_->reset();
  std::vector<std::uint16_t> expected = std::move(expected_);
  expected_.clear();
  const RangeCells cells{step, level_};
  const KnownColumns columns = known_columns(coded.data, coded.size);
  const bool slab = columns != kWholeFrame;
  if (!slab) {
    range = coder_->decode(coded.data, coded.size, returns.data(), cells, geometry(), expected.empty() ? nullptr : expected.data());
    memory_.forget_edge();
  } else {
    const bool expects = !expected.empty();
    if (!expects) expected.assign(returns.size(), 0);
    const Edge before = memory_.edge(static_cast<std::size_t>(columns));
    const Edge all = before.and_then({width_, {returns.begin(), returns.end()}, expected, fired});
    std::vector<std::uint8_t> known(all.ranges.size());
    std::transform(all.ranges.begin(), all.ranges.end(), known.begin(), [](std::uint16_t r) { return std::uint8_t{r != 0}; });
    MaskGeometry wide = geometry();
    wide.width = all.width;
    wide.fired = all.fired.data();
    const std::vector<std::uint16_t> image =
        coder_->decode(coded.data, coded.size, known.data(), cells, wide, expects ? all.expected.data() : nullptr,
                       static_cast<KnownColumns>(before.width), before.ranges.data());
    const Edge whole{all.width, image, all.expected, all.fired};
    Edge own = whole.last(width_);
    range = own.ranges;
    memory_.keep_edge(own);
  }
  memory_.remember(range, seen(), beams_.half, slab);
}

void Decoder::done(bool follows) {
  if (!follows) masks_.forget();
  masks_.remember(returns.data(), seen(), beams_.half);
}

}  // namespace lidarcodec::wasm
