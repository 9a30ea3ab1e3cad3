// Things that a town is full of: vehicles, people, trees and street furniture, as lists of parts in their own frame
// (x forward, y left, z up from the ground they stand on).
#pragma once
#include <vector>

#include "simulator/scene.hpp"

namespace lidarcodec::sim {

using Parts = std::vector<Part>;

enum class Vehicle { Hatchback, Saloon, Estate, Offroad, Minivan, Van, Truck, Bus, Motorbike, Bicycle };

struct Model {
  Parts parts;
  double length = 0, width = 0, height = 0;
  ObjectKind kind = ObjectKind::None;
};

// Shared models, made once: vehicles in a few sizes each, walkers in the phases of their gait.
class Models {
 public:
  Models();
  const Model& vehicle(Vehicle kind, std::uint64_t which) const;
  // A walker of one of a few builds; `gait` counts strides.
  const Model& walker(std::uint64_t which, double gait) const;
  const Model& plain_car() const { return plain_car_; }

  static constexpr int kSizes = 4;
  static constexpr int kBuilds = 5;
  static constexpr int kPhases = 8;

 private:
  std::vector<Model> vehicles_;
  std::vector<Model> walkers_;
  Model plain_car_;
};

// A car as traffic has them, drawn from hash `h`; `parked` leaves out what is not left at the kerb.
Vehicle usual_vehicle(std::uint64_t h, bool parked);
// Albedo of a car's paint: white, silver, colours and a lot of black.
float usual_paint(std::uint64_t h);

void add_tree(Rng& rng, Parts& parts, double height, double spread);
void add_conifer(Rng& rng, Parts& parts, double height, double spread);
void add_bush(Rng& rng, Parts& parts, double height, double spread);
void add_lamp(Rng& rng, Parts& parts, double height);
void add_sign(Rng& rng, Parts& parts);
void add_traffic_light(Rng& rng, Parts& parts);
void add_shelter(Rng& rng, Parts& parts);
void add_bench(Parts& parts);
// A bin, cabinet, bollard, planter, parking meter, advertising column or hydrant.
void add_furniture(Rng& rng, Parts& parts);

}  // namespace lidarcodec::sim
