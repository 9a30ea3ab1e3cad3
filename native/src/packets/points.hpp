// Points of an HDL-64E's returns in metres, by the formulas of lidarcodec/cloud.py, in the same order of operations.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

inline constexpr std::size_t kPointRows = 64, kPointBytes = 23;

// Of one row: everything about its laser.
struct PointBeam {
  double distance, near_across, near_along, cos_rotation, sin_rotation, cos_vertical, sin_vertical, up, aside;
  std::uint8_t laser;
  bool lower;  // whether it fires in the lower block
};

struct PointImages {
  std::size_t width;
  const std::uint32_t* range;     // (64, W), 0: no return
  const std::uint8_t* keep;       // (64, W), 0: dropped; null: all are kept
  const std::uint8_t* intensity;  // (64, W)
  const double *cosine, *sine;    // (2, W), of each half's azimuth
  const std::int64_t* t_ns;       // (W,)
};

// 23 bytes a return, without gaps, in the machine's byte order: x, y, z (float), intensity, laser, ring (byte), t_ns
// (int64). Column by column, in a column from the top ring down. turned: whether vertical offsets turn with the
// elevation; two_point: whether near targets have corrections of their own. Throws nothing.
std::vector<std::uint8_t> points_of_returns(const PointImages& images, const PointBeam* beams, double range_step,
                                            bool turned, bool two_point);

}  // namespace lidarcodec
