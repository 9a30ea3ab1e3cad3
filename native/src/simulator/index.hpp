// Which objects a beam can meet: the horizon around the sensor cut into sectors, in each the objects that reach into
// it, nearest first, with the range of slopes they cover.
#pragma once
#include <cstdint>
#include <vector>

#include "simulator/scene.hpp"

namespace lidarcodec::sim {

class Index {
 public:
  // Objects within `reach` metres; valid while the sensor stays within `slack` metres of `center` and every object
  // moves as its velocity says, for `seconds`.
  void build(const std::vector<const Object*>& objects, V3 center, double reach, double slack, double seconds);
  // Puts the nearest object in front of `hit.t` into `hit`; `dt` = seconds since the build.
  void trace(const Ray& ray, double dt, Hit& hit) const;

 private:
  struct Entry {
    float distance;            // of its nearest point, level, less the slack
    float slope_lo, slope_hi;  // rise over level distance
    const Object* object;
  };
  struct Near {
    double distance;
    std::size_t order;
    const Object* object;
  };
  static constexpr int kSectors = 1024;
  std::vector<std::vector<Entry>> sectors_ = std::vector<std::vector<Entry>>(kSectors);
  std::vector<Near> sorted_;
};

}  // namespace lidarcodec::sim
