// The canvas of video: a whole turn, on which the same direction is the same column in every frame
// (docs/wire-format.md, "h264 and h264-log"); in Python lidarcodec/ranges/video/turn_canvas.py.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

struct TurnLayout {
  std::size_t columns = 0, bands = 0;  // of a band; bands lie one below the other
  bool anchored = false;               // whether azimuths place columns
  std::size_t rows = 0;                // of the sensor; those of a band are the next multiple of 16

  bool operator==(const TurnLayout&) const = default;
  // Raises Section if there can be no such picture.
  void check() const;
  std::size_t places() const { return columns * bands; }
  std::size_t band_rows() const { return (rows + 15) / 16 * 16; }
  // Where the cell at a place is in the picture. place: 0 to places() - 1
  std::size_t cell(std::size_t row, std::size_t place) const {
    return (place / columns * band_rows() + row) * columns + place % columns;
  }
};

// (W,) places of columns, 0 to places() - 1, by their azimuths, 0.01 degree; of those that did not fire 0, and `fired`
// is empty where all did. Raises Section if there is no room.
std::vector<std::size_t> places_of(const TurnLayout& layout, const std::vector<std::uint16_t>& azimuth,
                                   const std::vector<std::uint8_t>& fired);

}  // namespace lidarcodec
