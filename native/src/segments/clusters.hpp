// Returns that belong together: the parts of a cloud, without the ground.
//
// After Bogoslavskyi and Stachniss, "Fast range image-based segmentation of sparse 3D laser scans for online operation"
// (IROS 2016): two neighbours in the range image lie on one object if the line between them is steep to the beam of the
// farther one. Here a neighbour is the next return of a row, and the next ones to the left and to the right in a few
// rows below, so that reduced images, with returns far apart, have neighbours too. Any return between two others keeps
// them apart: the beam went past both.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

// points: x y z in metres in the sensor's frame, finite; rows: row of each point's beam, below kMostRows, from the
// highest down; ground: 1 for points that belong to no object. Gives the number of each point's object, from 0 on in
// the order of their first points; -1 for ground.
std::vector<std::int32_t> cluster_points(const float* points, const std::uint16_t* rows, const std::uint8_t* ground,
                                         std::size_t count);

constexpr std::size_t kMostRows = 4096;

}  // namespace lidarcodec
