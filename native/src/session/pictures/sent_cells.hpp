// What is known of a frame of another sensor than an HDL-64E before its ranges are, which are a picture that keeps no
// bound (docs/wire-format-other-sensors.md, "Pictures"); in Python lidarcodec/ranges/image/range_cells.py.
#pragma once
#include <algorithm>
#include <utility>

#include "session/frames/image_frame.hpp"
#include "session/frames/picture_ranges.hpp"
#include "session/pictures/mapping.hpp"

namespace lidarcodec {

// Bits of ranges, and what follows the head of a RANGE section of codecs 6 to 9. Raises Section or Truncated.
std::pair<std::uint32_t, Bytes> split_picture_head(Bytes section);

// The cells of a frame that were sent.
class SentCells {
 public:
  // Raises Section for planes that no encoder writes.
  explicit SentCells(ImageFrame& frame) : frame_(frame) { check_second(frame.planes); }

  std::size_t rows() const { return frame_.sensor->rows(); }
  // The columns that were sent.
  std::size_t columns() const {
    return frame_.planes.empty() ? 0 : frame_.lattice.empty() ? frame_.width : frame_.lattice.size();
  }
  // Column of the frame of a column that was sent.
  std::size_t column(std::size_t sent) const { return frame_.lattice.empty() ? sent : frame_.lattice[sent]; }
  std::int64_t shift(std::size_t row) const { return frame_.shift[row]; }
  std::uint16_t azimuth(std::size_t sent) const { return frame_.azimuth[column(sent)]; }
  bool is_return(std::size_t row, std::size_t sent) const {
    return frame_.planes[0].values[row * frame_.width + column(sent)] != 0;
  }
  bool any_return() const;
  RangeScale scale(std::uint32_t bits) const {
    return RangeScale::of((std::uint32_t{1} << bits) - 1, frame_.sensor->range_step);
  }

  // Puts ranges of `bits` bits into the frame: range_of(row, sent) of each return.
  template <class RangeOf>
  void put(std::uint32_t bits, const RangeOf& range_of) {
    for (NamedPlane& plane : frame_.planes)
      if (plane.role == PlaneRole::SecondRange) plane.bits = std::max(plane.bits, bits);
    if (frame_.planes.empty()) return;
    frame_.planes[0].bits = bits;
    const std::int32_t most = (1 << bits) - 1;
    for (std::size_t row = 0; row < rows(); ++row)
      for (std::size_t sent = 0; sent < columns(); ++sent)
        if (is_return(row, sent))
          put_range(row * frame_.width + column(sent),
                    static_cast<std::uint32_t>(std::clamp(range_of(row, sent), 1, most)));
  }

 private:
  // A second range that is the small number of the first is the first one again.
  void put_range(std::size_t cell, std::uint32_t range);

  ImageFrame& frame_;
};

}  // namespace lidarcodec
