// What a spinning sensor reports of the surfaces that a beam meets: ranges, reflectivity, signal and near infrared.
#pragma once
#include <cstdint>
#include <vector>

#include "simulator/scene.hpp"

namespace lidarcodec::sim {

// How many returns a sensor sends of a firing, and in which order.
enum class Returns : std::uint8_t {
  Strongest,           // one
  StrongestAndSecond,  // the second is 0 if there is none
  LastAndStrongest     // both are the same if there is one
};

// The traits of a family of sensors. Counts are those of its signal and near infrared planes.
struct DetectorTraits {
  double step_m = 0.002;             // of a range
  double nearest_m = 0.5;            // ranges below are not sent
  double farthest_m = 100;           // ranges beyond are not sent
  double sees_10_m = 50;             // distance at which a surface of 10 % is just seen
  double sigma_m = 0.01;             // noise of a range, one standard deviation, for a strong echo
  double weak = 0.35;                // by how much the noise of the weakest echo is larger, as a share of sigma_m
  double pulse_m = 1.0;              // surfaces of one beam nearer to each other than this give one echo between them
  double spread = 0.002;             // half the divergence of the beam, radians
  double aperture_m = 0.02;          // half its width at the sensor
  double reflectivity = 100;         // number of a white surface
  double reflectivity_noise = 0.05;  // as a share
  double reflectivity_floor = 0.5;   // noise of a black surface
  double reflectivity_most = 255;
  double reflectivity_from_m = 0;  // nearer returns have reflectivity 0
  double diffuse_most = 255;       // reflectivity of whatever is no reflector
  double contrast = 0;             // share of the reflectivity that falls with its square: dark surfaces look darker
  double grazing = 0.3;            // share of the reflectivity that does not fall with the angle of incidence
  double quiet = 0;                // mean number of reflectivity without a return; 0: it is 0
  double photons = 0;              // counts of a white surface at 1 m; 0: there is no signal
  double dark = 0;                 // counts without a return
  double dark_noise = 1;           // of counts without a return, in square roots of counts
  double daylight = 0;             // counts of near infrared of a white surface
  double sky = 0;                  // counts of near infrared of the horizon
  double light_noise = 1;          // of near infrared, in square roots of counts
  double light_step = 1;           // counts of a step of near infrared
  double light_most = 65535;
  Returns returns = Returns::Strongest;
};

struct Measured {
  std::uint32_t range = 0;  // steps, 0 = no return
  std::uint16_t reflectivity = 0, signal = 0;
};

class Detector {
 public:
  Detector(const DetectorTraits& traits, std::size_t rows, std::uint64_t seed);

  // What row `row` sends of a firing. `hit`: the nearest surface; `behind`: another one that the beam meets as well, or
  // null; `luck`: random bits of this firing.
  void receive(std::size_t row, std::uint64_t luck, const Hit& hit, const Hit* behind, Measured& first,
               Measured& second);
  // Near infrared of a firing. `rise`: z of its direction.
  std::uint16_t light(const Hit& hit, double rise, std::uint64_t luck) const;

  const DetectorTraits& traits() const { return traits_; }

 private:
  struct Echo {
    double t = 0;      // metres; 0 = none
    double power = 0;  // of a white surface at 1 m: 1
    double lit = 0;    // reflectivity, 0 to about 1; retroreflectors more
    double slant = 0;  // metres by which the footprint is lengthened
    double rough = 0;
  };
  Echo echo_of(const Hit& hit) const;
  Measured measure(const Echo& echo, std::size_t row, std::uint64_t luck) const;
  bool seen(const Echo& echo, std::uint64_t luck) const;

  DetectorTraits traits_;
  double need_;               // least power that is seen
  std::vector<double> gain_;  // of the reflectivity of each row
  std::vector<double> wide_;  // noise of the ranges of each row, as a share of sigma_m
  std::vector<Echo> before_;  // of each row, at the firing before
};

}  // namespace lidarcodec::sim
