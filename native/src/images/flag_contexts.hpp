// Contexts of decisions about a cell as a whole: whether it has a return, and whether it repeats another plane.
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "images/models.hpp"
#include "images/plane_rows.hpp"
#include "images/rows.hpp"

namespace lidarcodec {

// kind: of the cell, below 4.
template <PlaneEffort Effort>
std::array<Odds*, PlaneModels<Effort>::kEqualContexts> equal_contexts(PlaneModels<Effort>& models,
                                                                      const PlaneRows& rows, const OtherPlanes& others,
                                                                      std::ptrdiff_t x, std::uint32_t kind) {
  const std::uint8_t *here = rows.equal[0] + x, *above = rows.equal[1] + x;
  const std::int32_t* off = (others.like != nullptr ? others.like : others.range)->error[0] + x;
  const std::uint32_t around =
      here[-1] | here[-2] << 1 | above[0] << 2 | above[-1] << 3 | above[1] << 4 | (off[0] > 2 * (off[-1] + 1)) << 5;
  const std::uint32_t size = std::min(quarter_log(static_cast<std::uint32_t>(off[0])) / 2, 31u);
  Odds* const odds = models.equal_odds.data();
  std::array<Odds*, PlaneModels<Effort>::kEqualContexts> contexts = {
      odds + around * 4 + kind, odds + 256 + kind * 32 + size, odds + 512 + (around & 7u) * 4 + kind};
  if constexpr (Effort == PlaneEffort::Follows) {
    const std::uint8_t* before = rows.equalled[0] + x;
    contexts[3] = odds + 768 + (before[0] & 15u) * 16 + (around & 5u) + (before[-1] & 1u) * 2 + (before[1] & 1u) * 8;
    contexts[4] = odds + 1024 + before[0];
  }
  return contexts;
}

// activity: of the errors around.
template <PlaneEffort Effort>
std::array<Odds*, PlaneModels<Effort>::kHasContexts> has_contexts(PlaneModels<Effort>& models, const PlaneRows& rows,
                                                                  std::ptrdiff_t x, std::size_t row,
                                                                  std::int32_t activity) {
  const std::uint8_t *here = rows.has[0] + x, *above = rows.has[1] + x, *second = rows.has[2] + x;
  const std::int32_t *off = rows.error[0] + x, *value = rows.value[0] + x;
  const std::uint32_t around = here[-1] | here[-2] << 1 | above[0] << 2 | above[-1] << 3 | above[1] << 4 |
                               second[0] << 5 | above[2] << 6 | here[-3] << 7;
  const std::uint32_t size = std::min(quarter_log(static_cast<std::uint32_t>(off[-1] + activity / 4)) / 2, 31u);
  const std::uint32_t range = std::min(quarter_log(static_cast<std::uint32_t>(value[-1]) >> 4) / 2, 15u);
  Odds* const odds = models.has_odds.data();
  std::array<Odds*, PlaneModels<Effort>::kHasContexts> contexts = {
      odds + around, odds + 512 + (row % 64) * 8 + (around & 7u), odds + 1024 + (around & 15u) * 32 + size,
      odds + 1536 + (around & 31u) * 16 + range};
  if constexpr (Effort == PlaneEffort::Follows) {
    const std::uint8_t* before = rows.had[0] + x;
    const std::uint32_t beside = (before[-1] & 1u) | (before[1] & 1u) << 1;
    contexts[4] = odds + 2048 + (before[0] & 15u) * 32 + (around & 5u) + beside * 8 + ((around ^ beside) & 1u) * 2;
    contexts[5] = odds + 2560 + before[0] * 2u + (around & 1u);
  }
  return contexts;
}

}  // namespace lidarcodec
