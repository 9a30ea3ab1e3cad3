// The PLANES section (docs/wire-format-other-sensors.md): all images of a frame of another sensor than an HDL-64E;
// lidarcodec/planes/plane_section.py writes it.
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "images/forms.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

// Bytes of the narrowest number of so many bits.
inline std::size_t plane_bytes(std::uint32_t bits) { return bits <= 8 ? 1 : bits <= 16 ? 2 : 4; }

// (H, W) numbers of `bits` bits. of: of an attribute, the place in the list of the range plane that it describes.
struct NamedPlane {
  std::string name;
  PlaneRole role = PlaneRole::Range;
  std::uint32_t bits = 16;
  std::size_t of = 0;
  PlaneImage values;
};

struct PlaneSection {
  std::size_t rows = 0;
  std::vector<std::int32_t> shift;  // columns by which each row moves, so that a column looks in one direction
  std::vector<NamedPlane> planes;   // the first is `range`
};

class PlaneMemory;  // images/memory.hpp: what planes that follow others remember

std::shared_ptr<PlaneMemory> empty_plane_memory();

// The planes of a section, `columns` wide. memory: of a stream whose frames may follow each other, else nothing. Raises
// Section or Truncated, before it takes more memory than the largest frame needs.
PlaneSection decode_plane_section(Bytes data, std::size_t columns, const Outside& outside, PlaneMemory* memory);

}  // namespace lidarcodec
