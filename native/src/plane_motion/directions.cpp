#include "plane_motion/directions.hpp"

#include <algorithm>
#include <cstdlib>

#include "base/error.hpp"
#include "base/varint.hpp"

namespace lidarcodec {
namespace {

constexpr std::int64_t kMostColumnError = kWholeTurn / 12'000;  // 0.03 degrees

// Columns that are the same step apart.
struct Piece {
  std::size_t count;
  std::uint32_t step;
};

// The longest piece after column `from`, which is at `at`.
Piece piece_from(const std::vector<std::int64_t>& wanted, std::size_t from, std::int64_t at) {
  std::int64_t low = 0, high = kMostColumnStep;
  std::size_t next = from + 1;
  for (; next < wanted.size(); ++next) {
    const auto steps = static_cast<std::int64_t>(next - from);
    const std::int64_t lowest = -floor_divided(-(wanted[next] - kMostColumnError - at), steps);
    const std::int64_t highest = floor_divided(wanted[next] + kMostColumnError - at, steps);
    if (std::max(low, lowest) > std::min(high, highest)) break;
    low = std::max(low, lowest);
    high = std::min(high, highest);
  }
  return {next - from, static_cast<std::uint32_t>((low + high) / 2)};
}

}  // namespace

bool beams_fit(const PlaneBeams& beams, std::size_t rows) {
  if (rows < 2 || beams.up.size() != rows || beams.aside.size() != rows) return false;
  for (std::size_t row = 0; row < rows; ++row) {
    if (std::abs(beams.up[row]) > kMostUp || std::abs(beams.aside[row]) > kMostAside) return false;
    if (row > 0 && beams.up[row - 1] - beams.up[row] < kLeastBetweenRows) return false;
  }
  return true;
}

PlaneColumns put_columns(std::vector<std::uint8_t>& out, const std::vector<std::uint16_t>& azimuth) {
  if (azimuth.size() < 2) return {};
  std::vector<std::int64_t> wanted = {0};
  for (std::size_t x = 1; x < azimuth.size(); ++x)
    wanted.push_back(wanted.back() + std::int64_t{angle_of_azimuth(azimuth[x]) - angle_of_azimuth(azimuth[x - 1])});
  if (wanted.back() >= 2 * kWholeTurn) return {};
  PlaneColumns columns{angle_of_azimuth(azimuth[0]), {0}};
  std::vector<Piece> pieces;
  while (columns.at.size() < azimuth.size()) {
    const std::size_t from = columns.at.size() - 1;
    const Piece piece = piece_from(wanted, from, columns.at[from]);
    if (piece.count < 2) return {};
    pieces.push_back({std::min(piece.count, azimuth.size() - 1 - from), piece.step});
    for (std::size_t i = 0; i < pieces.back().count; ++i) columns.at.push_back(columns.at.back() + piece.step);
  }
  if (columns.at.back() >= 2 * kWholeTurn || columns.step() == 0) return {};
  put_number(out, columns.first);
  put_number(out, pieces.size());
  for (const Piece& piece : pieces) {
    put_number(out, piece.count);
    put_number(out, piece.step);
  }
  return columns;
}

PlaneColumns take_columns(ByteReader& reader, std::size_t columns) {
  PlaneColumns found{take_number(reader), {0}};
  for (std::uint64_t left = take_number(reader); left > 0; --left) {
    const std::size_t count = take_number(reader);
    const std::uint32_t step = take_number(reader);
    if (count == 0 || count > columns - std::min(columns, found.at.size()) || step > kMostColumnStep)
      throw Error(ErrorCode::Section, "directions of more columns than a frame has, or too far apart", reader.at());
    for (std::size_t i = 0; i < count; ++i) found.at.push_back(found.at.back() + step);
  }
  if (found.at.size() != columns || columns < 2 || found.at.back() >= 2 * kWholeTurn || found.step() == 0)
    throw Error(ErrorCode::Section, "directions of columns that do not fit the frame", reader.at());
  return found;
}

void put_beams(std::vector<std::uint8_t>& out, const PlaneBeams& beams) {
  for (std::size_t row = 0; row < beams.up.size(); ++row) {
    put_signed(out, beams.up[row]);
    put_signed(out, beams.aside[row]);
  }
}

PlaneBeams take_beams(ByteReader& reader, std::size_t rows) {
  PlaneBeams beams;
  for (std::size_t row = 0; row < rows; ++row) {
    beams.up.push_back(take_signed(reader));
    beams.aside.push_back(take_signed(reader));
  }
  if (!beams_fit(beams, rows))
    throw Error(ErrorCode::Section, "directions of beams beyond their limits, or not from top to bottom", reader.at());
  return beams;
}

}  // namespace lidarcodec
