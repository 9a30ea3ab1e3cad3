// Mask coder of streams with memory: the format is docs/wire-format-sections.md, section "masks in streams".
//
// Where there were returns in the last turns, what the ranges are expected to be, and what was learned from one frame to the
// next: a fifth less than the coder of single masks (mask/coder.hpp) needs.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/model.hpp"
#include "mask/places.hpp"
#include "base/processor.hpp"

namespace lidarcodec {

// Kinds of masks beside those of mask/coder.hpp and planes/keep_coder.hpp.
inline constexpr std::uint8_t kMaskBegins = 6, kMaskGoesOn = 7;

// One at each end of a stream. After an error only `forget` may be called.
class MaskStream {
 public:
  // path: how it computes. All paths give the same bytes.
  explicit MaskStream(Path path = quickest_path()) : path_(path) {}

  void forget() { begun_ = false; }

  // Bytes of a mask, (64, W), of 0 and others. A mask without returns, or of nothing but returns, leaves the memory as it is.
  // Raises Section if a cell is set in a block that did not fire, or an azimuth is out of range.
  std::vector<std::uint8_t> encode(const std::uint8_t* mask, const MaskView& view);

  // (64, W) of 0 and 1, of a section of one of the two kinds. Raises Section or Truncated.
  std::vector<std::uint8_t> decode(const std::uint8_t* data, std::size_t size, const MaskView& view);

 private:
  template <class Bits>
  void code_on_path(const Bits& bits, const MaskView& view, std::uint8_t* rows);
  template <class Forms, class Bits>
  void code(Bits bits, const MaskView& view, std::uint8_t* rows);
  void begin(bool fresh);

  [[maybe_unused]] Path path_;  // some processors have one form only
  MaskPlaces places_;
  MaskModel model_;
  bool begun_ = false, fresh_ = false;
};

}  // namespace lidarcodec
