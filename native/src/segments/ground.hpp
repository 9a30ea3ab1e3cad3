// Which returns lie on the ground, for points of any sensor in any order.
//
// After Himmelsbach, von Hundelshausen and Wuensche, "Fast segmentation of 3D point clouds for ground vehicles" (IV
// 2010): the plane is divided into sectors and these into bins. The lowest return of each bin stands for it. Outwards
// from the sensor, a bin belongs to the ground if its lowest return lies near the height that the bins before predict.
// A return is ground if it lies at most kGroundM above the ground of its sector there.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

// points: x y z in metres in the sensor's frame, `count` of them, finite and z up. Gives 1 for ground, otherwise 0.
std::vector<std::uint8_t> ground_points(const float* points, std::size_t count);

}  // namespace lidarcodec
