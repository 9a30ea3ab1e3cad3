// Houses, in a frame with x along the street front (0 to `width`), y into the plot (front at 0) and z up from the
// ground.
#pragma once
#include "simulator/town/models.hpp"

namespace lidarcodec::sim {

struct HousePlan {
  double width = 10, depth = 11;
  int floors = 3;
  bool shop = false;      // shop windows on the ground floor
  bool free_ends = true;  // windows in the two ends as well
  bool old = false;       // tall windows, high floors, cornice
};

// A house of a closed row: facade, cornice, plinth, down-pipes, roof with dormers and chimneys.
void add_row_house(Rng& rng, const HousePlan& plan, Parts& parts);
// A house in a garden: steep roof, porch, garage.
void add_villa(Rng& rng, const HousePlan& plan, Parts& parts);
// A block of flats: flat roof, rows of balconies (given apart: they are many), stair towers.
void add_flats(Rng& rng, const HousePlan& plan, Parts& parts);
// A hall or supermarket: gates, a band of windows, things on the roof, a loading ramp.
void add_hall(Rng& rng, const HousePlan& plan, Parts& parts);
// One column of balconies or a bay window, centred on x = 0 in front of a wall at y = 0.
void add_balconies(Rng& rng, const HousePlan& plan, Parts& parts);

double first_floor_height(const HousePlan& plan);
double floor_height(const HousePlan& plan);
double eaves_height(const HousePlan& plan);

}  // namespace lidarcodec::sim
