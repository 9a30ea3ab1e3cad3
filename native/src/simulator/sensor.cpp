#include "simulator/sensor.hpp"

namespace lidarcodec::sim {

// Angles, offsets and corrections of a published unit with the optics of the S2 (laser layout, spacing of 1/3 and 1/2
// degree, +-26 mm): ROS driver `velodyne_pointcloud`, params/64e_s3-xiesc.yaml, BSD licence, rounded to the steps in
// which the sensor itself sends them. Far and near distance corrections are equal in the simulated unit, so decoders
// with and without the two-point correction give the same cloud.
//
// rotation, elevation [0.01 degree], distance, vertical offset, horizontal offset, focal distance [mm], focal slope
// [0.1]
const std::array<LaserRow, kLasers> kLaserTable{{
    {-438, -723, 1414, 216, 26, 10500, 18},  {-225, -685, 1509, 215, -26, 15000, 12},
    {344, 20, 1458, 206, 26, 24000, 10},     {568, 59, 1505, 206, -26, 14500, 17},
    {-5, -656, 1437, 215, 26, 15000, 4},     {219, -619, 1354, 214, -26, 17000, 14},
    {-88, -856, 1412, 217, 26, 10500, 10},   {139, -822, 1427, 217, -26, 14000, 13},
    {421, -589, 1381, 214, 26, 15000, 9},    {648, -548, 1364, 213, -26, 12500, 20},
    {341, -794, 1410, 217, 26, 12500, 20},   {568, -755, 1502, 216, -26, 13000, 19},
    {-434, -312, 1440, 210, 26, 14500, 17},  {-212, -279, 1521, 210, -26, 20500, 12},
    {-513, -513, 1475, 213, 26, 12500, 19},  {-291, -481, 1470, 213, -26, 19500, 9},
    {-11, -249, 1414, 210, 26, 24000, 7},    {215, -209, 1482, 209, -26, 14500, 16},
    {-87, -453, 1420, 212, 26, 17500, 14},   {137, -416, 1490, 212, -26, 24000, 12},
    {416, -181, 1482, 209, 26, 24000, 11},   {638, -146, 1555, 208, -26, 15500, 16},
    {340, -382, 1444, 211, 26, 20500, 12},   {561, -347, 1494, 211, -26, 14500, 16},
    {-439, 89, 1452, 205, 26, 11500, 20},    {-217, 129, 1535, 205, -26, 18500, 12},
    {-518, -114, 1532, 208, 26, 13000, 19},  {-294, -76, 1517, 208, -26, 21500, 11},
    {-11, 156, 1455, 205, 26, 13500, 18},    {211, 196, 1562, 204, -26, 18500, 14},
    {-89, -45, 1513, 207, 26, 18500, 14},    {133, -9, 1564, 207, -26, 21500, 11},
    {-733, -2236, 1308, 160, 26, 10500, 20}, {-381, -2198, 1430, 159, -26, 250, 10},
    {507, -1130, 1375, 147, 26, 250, 10},    {834, -1075, 1381, 146, -26, 11000, 20},
    {-29, -2149, 1431, 159, 26, 9500, 18},   {311, -2106, 1341, 158, -26, 9500, 14},
    {-161, -2456, 1490, 163, 26, 9000, 16},  {182, -2415, 1373, 162, -26, 250, 11},
    {654, -2043, 1435, 157, 26, 250, 9},     {994, -1989, 1336, 157, -26, 11200, 20},
    {548, -2355, 1491, 161, 26, 250, 11},    {890, -2297, 1329, 160, -26, 10000, 20},
    {-711, -1627, 1377, 152, 26, 11500, 20}, {-367, -1591, 1337, 152, -26, 250, 4},
    {-852, -1925, 1479, 156, 26, 11500, 20}, {-499, -1892, 1322, 155, -26, 250, 9},
    {-39, -1538, 1461, 151, 26, 13000, 10},  {300, -1493, 1341, 151, -26, 13500, 18},
    {-163, -1843, 1347, 155, 26, 12000, 18}, {182, -1796, 1363, 154, -26, 12000, 11},
    {628, -1429, 1447, 150, 26, 2000, 10},   {967, -1381, 1380, 149, -26, 11200, 20},
    {518, -1737, 1519, 154, 26, 2500, 10},   {852, -1680, 1380, 153, -26, 12500, 19},
    {-693, -1018, 1583, 145, 26, 10000, 20}, {-369, -974, 1384, 145, -26, 250, 9},
    {-830, -1316, 1549, 149, 26, 11500, 20}, {-488, -1283, 1365, 148, -26, 250, 10},
    {-34, -930, 1524, 144, 26, 5000, 11},    {290, -877, 1411, 144, -26, 2500, 10},
    {-157, -1229, 1501, 148, 26, 16500, 12}, {166, -1191, 1442, 147, -26, 9000, 14},
}};

Sensor::Sensor(std::uint64_t seed) : ripple_(kLasers * 24), rotation_(4000) {
  for (int laser = 0; laser < kLasers; ++laser) {
    const LaserRow& row = kLaserTable[static_cast<std::size_t>(laser)];
    Rng rng(hash_of(seed, laser));
    Laser& l = lasers_[static_cast<std::size_t>(laser)];
    l.cos_rot = cos_turns(row.rot_cdeg / 36000.0);
    l.sin_rot = sin_turns(row.rot_cdeg / 36000.0);
    l.cos_vert = cos_turns(row.vert_cdeg / 36000.0);
    l.sin_vert = sin_turns(row.vert_cdeg / 36000.0);
    l.vert_offset = row.vert_offset_mm * 0.001;
    l.horiz_offset = row.horiz_offset_mm * 0.001;
    l.dist = row.dist_mm * 0.001;
    // Real drives: 8.6-10.3 mm in the upper block, 7.2-7.5 in the lower, single lasers from 5.7 to 12.
    const double spread = rng.between(-1.0, 1.0);
    l.sigma = (laser < 32 ? 0.0092 : 0.0070) * (1.0 + 0.24 * spread * abs_of(spread) + 0.06 * spread);
    // Gain, dark level and reach differ from laser to laser.
    l.gain = rng.between(0.72, 1.16);
    l.offset = rng.between(-66.0, 4.0);
    l.reach = rng.between(0.55, 1.25);
    const double amplitude = (laser < 32 ? 0.0018 : 0.0028) * rng.between(0.6, 1.4);
    const std::array<double, 3> phase{rng.unit(), rng.unit(), rng.unit()};
    const std::array<double, 3> part{rng.between(0.4, 1.0), rng.between(0.3, 1.0), rng.between(0.2, 0.8)};
    for (int k = 0; k < 24; ++k) {
      const double third = part[0] * sin_turns(k / 3.0 + phase[0]);
      const double twelfth = part[1] * sin_turns(k / 12.0 + phase[1]);
      const double fast = part[2] * sin_turns(k * 5.0 / 12.0 + phase[2]);
      ripple_[static_cast<std::size_t>(laser * 24 + k)] = amplitude * (third + twelfth + fast);
    }
  }
  for (int k = 0; k < 4000; ++k)
    rotation_[static_cast<std::size_t>(k)] = {cos_turns(k / 4000.0), sin_turns(k / 4000.0)};
}

Beam Sensor::beam(int laser, int azimuth) const {
  const Laser& l = lasers_[static_cast<std::size_t>(laser)];
  const V2 turn = rotation_[static_cast<std::size_t>(azimuth / 9)];
  const double c = turn.x * l.cos_rot + turn.y * l.sin_rot;  // of rotation minus the laser's own correction
  const double s = turn.y * l.cos_rot - turn.x * l.sin_rot;
  const double back = l.vert_offset * l.sin_vert;
  return {{l.horiz_offset * s - back * c, l.horiz_offset * c + back * s, l.vert_offset * l.cos_vert},
          {l.cos_vert * c, -l.cos_vert * s, l.sin_vert}};
}

}  // namespace lidarcodec::sim
