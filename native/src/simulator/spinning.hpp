// A spinning sensor of any layout on a drive: beams and firing times in, what its detector measures out.
#pragma once
#include <mutex>

#include "simulator/detector.hpp"
#include "simulator/index.hpp"
#include "simulator/sensor.hpp"
#include "simulator/simulator.hpp"

namespace lidarcodec::sim {

// The firings of `columns` columns of `rows` rows; arrays are rows x columns.
struct Firings {
  std::size_t rows = 0, columns = 0;
  bool shared = false;                 // all rows of a column fire at once: `t_ns` has one row
  const std::int64_t* t_ns = nullptr;  // since the start of the drive
  // Two points of each beam in the sensor's frame: those of the ranges 0 and `far_m`.
  const double* near[3] = {};
  const double* far[3] = {};
  double far_m = 1;
};

// What is measured of each firing, rows x columns, and the true distance (0 = nothing) and Label.
struct Planes {
  std::vector<std::uint32_t> range, range2;
  std::vector<std::uint16_t> reflectivity, reflectivity2, signal, signal2, near_ir;
  std::vector<float> distance_m;
  std::vector<std::uint8_t> label;
};

// One call at a time: callers in several threads wait for each other.
class SpinningSimulator {
 public:
  // Throws Error(Settings) as make_world does.
  SpinningSimulator(const SimulatorOptions& options, const DetectorTraits& traits, std::size_t rows);

  // Columns must follow each other in time, also from call to call.
  void fire(const Firings& firings, Planes& out);

 private:
  void look_around(std::int64_t t_ns, V3 at);
  Hit trace(const Ray& ray, double reach, double dt);
  // Whether a beam meets another surface than `hit` as well: behind leaves, or beside its middle.
  bool meet_another(const Ray& ray, const Hit& hit, std::uint64_t luck, double dt, Hit& other);

  std::mutex busy_;
  std::unique_ptr<World> world_;
  Detector detector_;
  double reach_;
  Index index_;
  std::vector<const Object*> objects_;
  std::uint64_t luck_;
  std::uint64_t column_ = 0;
  std::int64_t now_ns_ = 0, index_ns_ = 0;
  bool looked_ = false;
};

}  // namespace lidarcodec::sim
