// How a sensor moved between two frames of planes. docs/wire-format-planes.md, "Motion", has the format.
#pragma once
#include <array>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "base/error.hpp"
#include "base/varint.hpp"
#include "plane_motion/directions.hpp"

namespace lidarcodec {

// Points of the frame before become points of this one: turned, then shifted. x is forward, y right, z up. turn: a
// Cayley vector, half the axis of a small turn, in steps of 2^-18; shift: in eighths of a range.
struct PlaneMotion {
  static constexpr std::int32_t kMostTurn = 1 << 16, kMostShift = 1 << 22;

  std::array<std::int32_t, 3> turn{}, shift{};

  // The rotation matrix, row by row, in steps of 2^-24: 1 + 2 (S [h] + [h]^2) / (S^2 + h.h) with S = 2^18.
  std::array<std::int64_t, 9> rotation() const {
    const std::int64_t x = turn[0], y = turn[1], z = turn[2], square = x * x + y * y + z * z;
    const std::int64_t scale = (std::int64_t{1} << 36) + square;
    const std::array<std::int64_t, 9> spin = {0, -z, y, z, 0, -x, -y, x, 0};
    std::array<std::int64_t, 9> found;
    for (std::size_t i = 0; i < 9; ++i) {
      const bool same = i / 3 == i % 3;
      const std::int64_t squared = std::int64_t{turn[i / 3]} * turn[i % 3] - (same ? square : 0);
      const std::int64_t turned = 2 * ((spin[i] << 18) + squared) + (same ? scale : 0);
      found[i] = floor_divided((turned << 24) + scale / 2, scale);
    }
    return found;
  }

  bool within() const {
    for (std::size_t i = 0; i < 3; ++i)
      if (std::abs(turn[i]) > kMostTurn || std::abs(shift[i]) > kMostShift) return false;
    return true;
  }
};

inline void put_motion(std::vector<std::uint8_t>& out, const PlaneMotion& motion) {
  for (const std::int32_t part : motion.turn) put_signed(out, part);
  for (const std::int32_t part : motion.shift) put_signed(out, part);
}

inline PlaneMotion take_motion(ByteReader& reader) {
  PlaneMotion motion;
  for (std::int32_t& part : motion.turn) part = take_signed(reader);
  for (std::int32_t& part : motion.shift) part = take_signed(reader);
  if (motion.within()) return motion;
  throw Error(ErrorCode::Section, "a motion beyond its limits", reader.at());
}

}  // namespace lidarcodec
