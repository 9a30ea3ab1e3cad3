#include "session/pictures/turn_canvas.hpp"

#include <algorithm>
#include <string>

#include "base/error.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kMacroblock = 16, kMostWidth = 8192, kMostBands = 16, kMostPlaces = 32'768;
constexpr std::int64_t kTurn = 36'000;

}  // namespace

void TurnLayout::check() const {
  if (columns == 0 || columns % kMacroblock != 0 || columns > kMostWidth || bands == 0 || bands > kMostBands ||
      places() > kMostPlaces)
    throw Error(ErrorCode::Section,
                "a video of " + std::to_string(bands) + " bands of " + std::to_string(columns) + " columns");
}

std::vector<std::size_t> places_of(const TurnLayout& layout, const std::vector<std::uint16_t>& azimuth,
                                   const std::vector<std::uint8_t>& fired) {
  const auto room = static_cast<std::int64_t>(layout.places());
  std::vector<std::size_t> places(azimuth.size());
  std::int64_t angle = 0, place = 0, first = 0;
  for (std::size_t c = 0, before = azimuth.size(); c < azimuth.size(); ++c) {
    if (!layout.anchored) {
      place = static_cast<std::int64_t>(c);
    } else if (!fired.empty() && fired[c] == 0) {
      continue;
    } else if (before == azimuth.size()) {
      angle = azimuth[c];
      first = place = angle * static_cast<std::int64_t>(layout.columns) / kTurn;
      before = c;
    } else {
      angle += (std::int64_t{azimuth[c]} - azimuth[before] + kTurn) % kTurn;
      place = std::max(place + 1, angle * static_cast<std::int64_t>(layout.columns) / kTurn);
      before = c;
    }
    if (place - first >= room)
      throw Error(ErrorCode::Section,
                  "a frame of " + std::to_string(azimuth.size()) + " columns on " + std::to_string(room) + " places");
    places[c] = static_cast<std::size_t>(place % room);
  }
  return places;
}

}  // namespace lidarcodec
