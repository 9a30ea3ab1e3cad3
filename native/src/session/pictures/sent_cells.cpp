#include "session/pictures/sent_cells.hpp"

#include <string>

#include "base/varint.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint64_t kMostStep = 40'001;

}  // namespace

std::pair<std::uint32_t, Bytes> split_picture_head(Bytes section) {
  VarintReader reader(section, "ranges");
  const std::uint32_t bits = reader.byte();
  const std::uint64_t step = reader.number(kMostStep, 1);
  if (bits < 1 || bits > kMostPlaneBits || step != 1)  // these codecs keep no bound
    throw Error(ErrorCode::Section,
                "a picture of ranges of " + std::to_string(bits) + " bits with step " + std::to_string(step));
  return {bits, reader.rest()};
}

bool SentCells::any_return() const {
  for (std::size_t row = 0; row < rows(); ++row)
    for (std::size_t sent = 0; sent < columns(); ++sent)
      if (is_return(row, sent)) return true;
  return false;
}

void SentCells::put_range(std::size_t cell, std::uint32_t range) {
  const std::uint32_t small = frame_.planes[0].values[cell];
  for (NamedPlane& plane : frame_.planes)
    if (plane.role == PlaneRole::SecondRange && plane.values[cell] == small) plane.values[cell] = range;
  frame_.planes[0].values[cell] = range;
}

}  // namespace lidarcodec
