// Mask coder of streams with memory: the format is docs/wire-format-sections.md, section "masks in streams".
//
// Its contexts are the masks of the last turns, the expected ranges and the rows above. Its models go on from frame to
// frame.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/processor.hpp"
#include "mask/model.hpp"
#include "mask/places.hpp"

namespace lidarcodec {

// Kinds of masks beside those of mask/coder.hpp and planes/keep_coder.hpp.
inline constexpr std::uint8_t kMaskBegins = 6, kMaskGoesOn = 7;

// One at each end of a stream. After an error only `forget` may be called.
class MaskStream {
 public:
  // path: which instructions it uses; all paths give the same bytes.
  explicit MaskStream(Path path = quickest_path()) : path_(path) {}

  void forget() { begun_ = false; }

  // Encodes a mask, (64, W); 0: no return. A mask without returns, or with all fired cells returns, does not change the
  // models. Raises Section if a cell is set in a block that did not fire, or an azimuth is out of range.
  std::vector<std::uint8_t> encode(const std::uint8_t* mask, const MaskView& view);

  // The mask, (64, W) of 0 and 1, from a section of one of the two kinds. Raises Section or Truncated.
  std::vector<std::uint8_t> decode(const std::uint8_t* data, std::size_t size, const MaskView& view);

 private:
  template <class Bits>
  void code_on_path(const Bits& bits, const MaskView& view, std::uint8_t* rows);
  template <class Forms, class Bits>
  void code(Bits bits, const MaskView& view, std::uint8_t* rows);
  void begin(bool fresh);

  [[maybe_unused]] Path path_;  // unused where there is one form
  MaskTables places_;
  MaskModel model_;
  bool begun_ = false, fresh_ = false;
};

}  // namespace lidarcodec
