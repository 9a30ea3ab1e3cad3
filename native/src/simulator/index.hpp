// The objects that a beam can hit. The horizon around the sensor is divided into sectors; each lists the objects that
// reach into it, nearest first, with the elevations that they cover.
#pragma once
#include <vector>

#include "simulator/scene.hpp"

namespace lidarcodec::sim {

class Index {
 public:
  // Lists the objects within `reach` metres. Valid for `seconds`, while the sensor stays within `slack` metres of
  // `center` and each object keeps its velocity.
  void build(const std::vector<const Object*>& objects, V3 center, double reach, double slack, double seconds);
  // Puts the nearest object in front of `hit.t` into `hit`; `dt` = seconds since the build.
  void trace(const Ray& ray, double dt, Hit& hit) const;

 private:
  struct Entry {
    float distance;        // of its nearest point, horizontally, minus the slack
    float tan_lo, tan_hi;  // tangents of the elevations
    const Object* object;
  };
  static constexpr int kSectors = 1024;
  std::vector<std::vector<Entry>> sectors_ = std::vector<std::vector<Entry>>(kSectors);
};

}  // namespace lidarcodec::sim
