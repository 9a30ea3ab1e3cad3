// Frames that were thinned to some of their columns, put back into their own (docs/wire-format-sections.md, "Lattice").
#pragma once
#include "session/planes.hpp"

namespace lidarcodec {

// The planes in the whole frame's columns. Of those that were not sent nothing is said in `fired`: the side information
// is not looked into. section: LATTICE. Raises Section or Truncated.
Planes in_own_columns(const Planes& narrow, Bytes section, const Outside& outside);

}  // namespace lidarcodec
