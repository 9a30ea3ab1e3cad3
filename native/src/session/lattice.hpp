// Frames that were thinned to some of their columns, put back into their own (docs/wire-format-sections.md, "Lattice").
#pragma once
#include "session/planes.hpp"

namespace lidarcodec {

// Columns of a whole frame, ascending, that were sent; packets: whether the section holds side information, too.
struct Lattice {
  std::size_t width = 0;
  std::vector<std::size_t> columns;
  bool packets = false;
};

// section: LATTICE. Raises Section or Truncated.
Lattice read_lattice(Bytes section, const Outside& outside);

// The `rows` rows of an image in the frame's own columns; 0 in those that were not sent.
template <class Number>
std::vector<Number> widened(const std::vector<Number>& narrow, std::size_t rows, const Lattice& lattice) {
  const std::size_t count = lattice.columns.size();
  std::vector<Number> wide(rows * lattice.width);
  for (std::size_t row = 0; row < rows; ++row)
    for (std::size_t i = 0; i < count; ++i) wide[row * lattice.width + lattice.columns[i]] = narrow[row * count + i];
  return wide;
}

// The planes in the whole frame's columns. Of those that were not sent nothing is said in `fired`: the side information
// is not looked into. section: LATTICE. Raises Section or Truncated.
Planes in_own_columns(const Planes& narrow, Bytes section, const Outside& outside);

}  // namespace lidarcodec
