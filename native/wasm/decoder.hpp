// Decoder of one stream for a page: what a message's sections hold, in arrays that the page lays over the memory of the module.
// The page takes messages apart (header, sections, checksum, zstd frames) and says what is where; this is the rest.
//
// Nothing is caught. An error ends the call in the host (errors.cpp), which throws the whole module away: a stream goes on
// with its next message that needs no other, in a fresh one.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "motion/beams.hpp"
#include "mask/coder.hpp"
#include "mask/stream.hpp"
#include "predictive/coder.hpp"
#include "motion/range_history.hpp"
#include "stream_memory.hpp"

namespace lidarcodec::wasm {

inline constexpr std::size_t kMostColumns = 24'576;
inline constexpr std::size_t kMostBytes = 64u << 20;

struct Bytes {
  const std::uint8_t* data = nullptr;
  std::size_t size = 0;
};

class Decoder {
 public:
  // Of each row: half (0 upper, 1 lower), and rotation, vertical, distance corrections, vertical and horizontal offsets in
  // steps of the calibration table; (6, 64).
  void sensor(const std::int32_t* rows);

  // Sections AZIMUTH, and MASK or KEEP. follows: whether the message needs another, whose mask may be referred to.
  // motion: section MOTION, by which what is expected is known before the mask; its data is nullptr if there is none.
  void columns(Bytes azimuth, std::size_t width);
  void mask(Bytes mask, bool keep, Bytes motion, bool follows);

  // Modelled intensities, of the returns.
  void intensity(Bytes coded);

  // Makes the coder of ranges learn anew with networks of a weight file's layers, or without any; see `net`.
  void begin_nets() { nets_ = std::make_shared<RiddleNets>(); }
  void net(Bytes layers, std::size_t first, std::size_t second, std::array<std::uint32_t, kNetLayers> shifts, bool expects);
  void use_nets(bool learned);

  // Section RANGE behind its step (and what names the weights).
  void ranges(Bytes coded, std::uint32_t step, bool follows);

  // Notes what the message was, for those that need it; ranges of codecs that are not decoded here need none of it.
  void done(bool follows);

  std::vector<std::uint16_t> azimuth, range;         // (2, W), (64, W)
  std::vector<std::uint8_t> fired, returns, bright;  // (2, W), (64, W), (64, W)

 private:
  MaskGeometry geometry() const;
  MaskView view() const;
  Columns seen() const { return {width_, azimuth.data(), fired.data()}; }

  std::size_t width_ = 0;
  BeamTable beams_;
  std::array<std::int32_t, kMaskRows> level_{};
  MaskMemory masks_;
  MaskStream stream_;
  StreamMemory memory_;
  Motion motion_;                        // of the message at hand
  std::vector<std::uint16_t> expected_;  // (64, W), or nothing
  std::shared_ptr<RiddleNets> nets_;
  std::unique_ptr<PredictiveCoder> coder_ = std::make_unique<PredictiveCoder>();
};

}  // namespace lidarcodec::wasm
