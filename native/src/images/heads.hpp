// How the planes of a frame are coded, as the heads in front of their streams say.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/bytes.hpp"
#include "base/varint.hpp"
#include "images/forms.hpp"
#include "images/plane_rows.hpp"

namespace lidarcodec {

inline constexpr std::size_t kNoMate = 255;

// How one plane is coded.
struct PlaneHead {
  PlanePlan plan;
  std::uint32_t unit = 1;  // of an attribute: all values are multiples of it
  std::size_t mate = kNoMate;
  std::size_t bytes = 0;  // of its stream
};

// Of one plane, in rows that are aligned.
using PlaneNumbers = std::vector<std::int32_t>;

// Heads of the best ways to code these numbers, which are divided by their units. quick: fewer values are symbols.
std::vector<PlaneHead> choose_heads(const PlaneFrame& frame, std::vector<PlaneNumbers>& all, bool quick);

void write_head(std::vector<std::uint8_t>& out, const PlaneFrame& frame, const PlaneHead& head, std::size_t plane);

// The heads of all planes. Raises Section or Truncated.
std::vector<PlaneHead> read_heads(ByteReader& reader, const PlaneFrame& frame);

}  // namespace lidarcodec
