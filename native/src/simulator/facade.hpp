// The body of a house: walls with recessed windows, doors and shop fronts. They are computed where a beam hits the
// wall, instead of being stored as thousands of boxes.
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
