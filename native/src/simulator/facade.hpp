// A house body: walls with recessed windows, doors and shop fronts worked out where the beam meets the wall, instead of
// being kept as thousands of boxes.
#pragma once
#include "simulator/scene.hpp"

namespace lidarcodec::sim {

// A ray in the frame of an object.
struct LocalRay {
  V3 o, d;
  std::uint32_t luck = 0, id = 0;
  double paint = 0;
};

void trace_facade(const Part& part, const LocalRay& ray, Hit& hit);

}  // namespace lidarcodec::sim
