// The first byte of coded ranges: a bit field (docs/wire-format-predictive.md, "Section").
#pragma once
#include <cstdint>

namespace lidarcodec {

struct RangeKind {
  bool expected = false;  // there is an image of expected ranges
  bool slab = false;      // of a slab, not of a whole frame
  bool network = false;   // a network gives the prior
  bool quick = false;     // fewer contexts, and leaves of its own; never with a network
  bool free = false;      // cells are counted from the last return, not from 0; only with steps above 1
  bool halves = false;    // rows 0 to 31 and 32 to 63 are coded each with models of their own; never of a slab

  constexpr std::uint8_t byte() const {
    return static_cast<std::uint8_t>(expected | slab << 1 | network << 2 | quick << 3 | free << 4 | halves << 5);
  }

  static constexpr RangeKind of(std::uint8_t byte) {
    return {(byte & 1) != 0, (byte & 2) != 0, (byte & 4) != 0, (byte & 8) != 0, (byte & 16) != 0, (byte & 32) != 0};
  }

  // Whether a byte is a valid kind: bits 6 and 7 are 0, and of network and quick, of slab and halves one is not set.
  static constexpr bool is_known(std::uint8_t byte) {
    const RangeKind kind = of(byte);
    return byte < 64 && !(kind.network && kind.quick) && !(kind.slab && kind.halves);
  }
};

}  // namespace lidarcodec
