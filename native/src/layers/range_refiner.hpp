// Refinement of ranges: what is left of them once a coarse layer, the base, is known. docs/wire-format-layers.md has
// the format.
//
// A base says of each return that it lies within half a step of a value. The whole base is known here, also what lies
// ahead of a return, and so are the exact ranges of the returns before it. A linear prediction that learns by least
// mean squares brings both together; the place in the step is then coded by a few decisions, whose contexts see where
// the prediction and single neighbours lie.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mask/coder.hpp"

namespace lidarcodec {

inline constexpr std::uint32_t kMaxLayerStep = 20'001;

// Both steps are odd, and `fine` is below `base`. turn: columns in a full turn, 0: rows are not shifted.
struct LayerSteps {
  std::uint32_t base = 3, fine = 1, turn = 0;
};

// `base`: (64, W) ranges of the base, 0 where there is no return; `level`: of each row, what is added to its ranges so
// that all rows are on one scale, 0 to 1000.
struct LayerImage {
  const MaskGeometry& geometry;
  const std::uint16_t* base;
  const std::int32_t* level;
};

// `ranges`: (64, W), read at the returns of the base. Raises Section if one is further from the base than half a step,
// if a return lies in a block that did not fire, or for steps and levels beyond the limits.
std::vector<std::uint8_t> encode_refinement(const LayerImage& image, const std::uint16_t* ranges,
                                            const LayerSteps& steps);

// (64, W), 0 outside of the returns. Raises Section or Truncated.
std::vector<std::uint16_t> decode_refinement(const std::uint8_t* data, std::size_t size, const LayerImage& image,
                                             const LayerSteps& steps);

}  // namespace lidarcodec
