// The points of a tile of a map: cells by an octree (maps/cells.hpp), then each point within its cell, then its columns
// of numbers, such as a normal or a count.
//
// A map lies on surfaces. So a plane through the points that were coded before, near a cell, says where the next point
// lies along the steepest axis. docs/wire-format-maps.md defines the bytes.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "base/bytes.hpp"

namespace lidarcodec {

inline constexpr std::size_t kMostColumns = 8;
inline constexpr unsigned kMostColumnBits = 16;
inline constexpr std::uint32_t kMostSteps = 1u << 20;  // coordinates in a tile
inline constexpr std::uint32_t kMostCell = 1u << 10;
inline constexpr std::size_t kMostTilePoints = 4'000'000;

// How a tile is coded. levels: of the octree, 0 to 16; cell: its width in steps; reach: width in cells of the space in
// which neighbours are searched; bits: of the values of each column, 1 to 16.
struct TileForm {
  unsigned levels;
  std::uint32_t cell;
  std::uint32_t reach;
  std::vector<unsigned> bits;
};

// points: x, y, z of each, from 0 to cell * 2^levels - 1, no two alike; values: those of each column, point by point.
struct TilePoints {
  std::vector<std::array<std::uint32_t, 3>> points;
  std::vector<std::uint16_t> values;
};

// The points in any order. Raises Settings for points or a form that cannot be coded.
std::vector<std::uint8_t> encode_tile(const TilePoints& tile, const TileForm& form);

// `count` points in the order in which they were coded. Raises Section, Truncated.
TilePoints decode_tile(Bytes data, std::size_t count, const TileForm& form);

}  // namespace lidarcodec
