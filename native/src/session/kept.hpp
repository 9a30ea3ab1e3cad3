// What a stream remembers after a frame, and that of a few frames: a message may refer to any of them. The rule is
// docs/wire-format.md ("Which frames a message may refer to").
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "mask/stream.hpp"
#include "planes/intensity_coder.hpp"
#include "predictive/coder.hpp"
#include "session/history.hpp"

namespace lidarcodec {

// Which networks the coder of ranges has; without any the name is "".
struct UsedNets {
  std::string weights;
  std::uint8_t effort = 0;
  bool operator==(const UsedNets&) const = default;
};

// What the next frame may refer to.
struct Remembered {
  MaskMemory masks;
  // Of codecs that expect ranges; made for their streams alone, for they are large.
  std::optional<MaskStream> mask_stream;
  std::optional<StreamMemory> memory;
  std::optional<IntensityMemory> intensities;
  std::unique_ptr<PredictiveCoder> coder;
  std::optional<UsedNets> used;

  Remembered() = default;
  Remembered(Remembered&&) = default;
  Remembered& operator=(Remembered&&) = default;
  Remembered(const Remembered& other)
      : masks(other.masks),
        mask_stream(other.mask_stream),
        memory(other.memory),
        intensities(other.intensities),
        coder(other.coder == nullptr ? nullptr : std::make_unique<PredictiveCoder>(*other.coder)),
        used(other.used) {}
  Remembered& operator=(const Remembered&) = delete;
  ~Remembered() = default;
};

// What was remembered after each of the last few frames that were decoded or referred to, but for the last one.
class KeptFrames {
 public:
  void forget() { kept_.clear(); }

  // Keeps what is remembered after a frame, in place of that of the frame that was put longest ago.
  void put(std::uint64_t index, Remembered&& remembered) {
    kept_.emplace_back(index, std::move(remembered));
    if (kept_.size() > kMost) kept_.pop_front();
  }

  // Takes out what was remembered after a frame; nothing if it is not kept.
  std::optional<Remembered> take(std::uint64_t index) {
    const auto one = std::find_if(kept_.begin(), kept_.end(), [&](const auto& kept) { return kept.first == index; });
    if (one == kept_.end()) return std::nullopt;
    std::optional<Remembered> found(std::move(one->second));
    kept_.erase(one);
    return found;
  }

 private:
  static constexpr std::size_t kMost = 4;
  std::deque<std::pair<std::uint64_t, Remembered>> kept_;
};

}  // namespace lidarcodec
