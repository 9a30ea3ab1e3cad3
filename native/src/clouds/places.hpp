// Points of many ranges and directions at a time: of each the ones that `place_of` gives.
#pragma once
#include <span>

#include "clouds/geometry.hpp"

namespace lidarcodec {

class Places {
 public:
  static constexpr std::size_t kPoints = 256;  // at a time

  explicit Places(const CloudGeometry& geometry);

  // Of kPoints at most, of rows of the geometry.
  void find(std::span<const std::int64_t> row, const std::uint32_t* n, const std::int32_t* k) {
    find_(geometry_, row, n, k, *this);
  }

  std::array<double, kPoints> x, y, z, rho;

 private:
  const CloudGeometry& geometry_;
  void (*find_)(const CloudGeometry&, std::span<const std::int64_t>, const std::uint32_t*, const std::int32_t*,
                Places&);
};

}  // namespace lidarcodec
