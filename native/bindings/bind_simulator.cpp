#include <nanobind/stl/string.h>
#include <nanobind/stl/unique_ptr.h>

#include <algorithm>
#include <cmath>
#include <string_view>

#include "base/error.hpp"
#include "bindings.hpp"
#include "simulator/simulator.hpp"
#include "simulator/spinning.hpp"

namespace {

namespace sim = lidarcodec::sim;

constexpr std::size_t kMostPackets = 100'000;
constexpr std::uint64_t kMostSkipped = 9'000'000'000;  // 30 days
constexpr double kMostReachM = 200;
constexpr std::int64_t kLongestNs = std::int64_t{30} * 86400 * 1'000'000'000;

sim::SimulatorOptions options_of(const std::string& scene, std::uint64_t seed, double speed, double traffic,
                                 std::int64_t start_ns) {
  sim::SimulatorOptions options;
  options.scene = scene;
  options.world = {seed, speed, traffic};
  options.start_ns = start_ns;
  return options;
}

using Counts16 = Array<std::uint16_t>;
using Counts32 = Array<std::uint32_t>;
constexpr std::size_t kMostCells = std::size_t{1} << 23;
constexpr std::int64_t kLongestFiringNs = std::int64_t{31} * 86400 * 1'000'000'000;

void check(bool right, const char* text) {
  if (!right) throw lidarcodec::Error(lidarcodec::ErrorCode::Settings, text);
}

using Traits = sim::DetectorTraits;
using Numbers = nb::typed<nb::dict, nb::str, double>;

// Traits by name, as in native/src/simulator/detector.hpp; `returns` as the number of its kind.
Traits traits_of(const Numbers& numbers) {
  static constexpr std::pair<std::string_view, double Traits::*> kMembers[] = {
      {"step_m", &Traits::step_m},
      {"nearest_m", &Traits::nearest_m},
      {"farthest_m", &Traits::farthest_m},
      {"sees_10_m", &Traits::sees_10_m},
      {"sigma_m", &Traits::sigma_m},
      {"weak", &Traits::weak},
      {"pulse_m", &Traits::pulse_m},
      {"spread", &Traits::spread},
      {"aperture_m", &Traits::aperture_m},
      {"reflectivity", &Traits::reflectivity},
      {"reflectivity_noise", &Traits::reflectivity_noise},
      {"reflectivity_floor", &Traits::reflectivity_floor},
      {"reflectivity_most", &Traits::reflectivity_most},
      {"reflectivity_from_m", &Traits::reflectivity_from_m},
      {"diffuse_most", &Traits::diffuse_most},
      {"contrast", &Traits::contrast},
      {"grazing", &Traits::grazing},
      {"quiet", &Traits::quiet},
      {"photons", &Traits::photons},
      {"dark", &Traits::dark},
      {"dark_noise", &Traits::dark_noise},
      {"daylight", &Traits::daylight},
      {"sky", &Traits::sky},
      {"light_noise", &Traits::light_noise},
      {"light_step", &Traits::light_step},
      {"light_most", &Traits::light_most},
  };
  Traits traits;
  for (const auto& [key, value] : numbers) {
    const auto name = nb::cast<std::string>(key);
    const auto number = nb::cast<double>(value);
    if (name == "returns") {
      check(number == 0 || number == 1 || number == 2, "returns are 0, 1 or 2");
      traits.returns = static_cast<sim::Returns>(static_cast<int>(number));
      continue;
    }
    const auto* member =
        std::find_if(std::begin(kMembers), std::end(kMembers), [&](const auto& known) { return known.first == name; });
    check(member != std::end(kMembers), "no such trait of a detector");
    traits.*(member->second) = number;
  }
  check(traits.step_m > 0 && traits.sees_10_m > 0 && traits.light_step > 0, "steps and reach are positive");
  check(traits.farthest_m > 0 && traits.farthest_m / traits.step_m < 4e9, "a range has 32 bits");
  return traits;
}

}  // namespace

void bind_simulator(nb::module_& m) {
  nb::class_<sim::Simulator>(m, "Simulator", "A simulated HDL-64E S2 on a drive; see lidarcodec.sources.simulator.")
      .def(
          "__init__",
          [](sim::Simulator* self, const std::string& scene, std::uint64_t seed, double speed, double traffic,
             std::int64_t start_ns) { new (self) sim::Simulator(options_of(scene, seed, speed, traffic, start_ns)); },
          nb::arg("scene"), nb::arg("seed"), nb::arg("speed"), nb::arg("traffic"), nb::arg("start_ns"))
      .def(
          "packets",
          [](sim::Simulator& self, std::size_t count) {
            if (count > kMostPackets)
              throw lidarcodec::Error(lidarcodec::ErrorCode::Settings, "at most 100000 packets a call");
            std::vector<std::uint8_t> bytes(count * sim::kPacketBytes);
            {
              nb::gil_scoped_release release;
              self.packets(count, bytes.data());
            }
            return give(std::move(bytes), {count, static_cast<std::size_t>(sim::kPacketBytes)});
          },
          nb::arg("count"), "The next packets: uint8 (count, 1206).")
      .def(
          "packets_with_truth",
          [](sim::Simulator& self, std::size_t count) -> Tuple<Array<std::uint8_t>, Array<float>, Array<std::uint8_t>> {
            if (count > kMostPackets)
              throw lidarcodec::Error(lidarcodec::ErrorCode::Settings, "at most 100000 packets a call");
            std::vector<std::uint8_t> bytes(count * sim::kPacketBytes);
            sim::Truth truth;
            {
              nb::gil_scoped_release release;
              self.packets(count, bytes.data(), &truth);
            }
            const std::size_t firings = count * sim::kFiringsPerPacket, lasers = sim::kLasers;
            return nb::make_tuple(give(std::move(bytes), {count, static_cast<std::size_t>(sim::kPacketBytes)}),
                                  give(std::move(truth.distance_m), {firings, lasers}),
                                  give(std::move(truth.label), {firings, lasers}));
          },
          nb::arg("count"),
          "The next packets, true distances float32 (firings, 64) in metres and labels uint8 (firings, 64).")
      .def(
          "ground_height",
          [](sim::Simulator& self, In<double, 2> places) {
            const std::size_t n = places.shape(0);
            if (places.shape(1) != 2) throw lidarcodec::Error(lidarcodec::ErrorCode::Settings, "places are (N, 2)");
            const double* p = places.data();
            for (std::size_t k = 0; k < 2 * n; ++k)
              if (!(p[k] > -1e8 && p[k] < 1e8))
                throw lidarcodec::Error(lidarcodec::ErrorCode::Settings, "the world ends at 1e8 m");
            std::vector<double> out(n);
            {
              nb::gil_scoped_release release;
              self.ground_height(p, n, out.data());
            }
            return give(std::move(out), {n});
          },
          nb::arg("places").noconvert(), "Height of the ground at places (N, 2).")
      .def(
          "skip",
          [](sim::Simulator& self, std::uint64_t count) {
            if (count > kMostSkipped)
              throw lidarcodec::Error(lidarcodec::ErrorCode::Settings, "at most 30 days are skipped");
            nb::gil_scoped_release release;
            self.skip(count);
          },
          nb::arg("count"), "Drives on for that many packets without tracing beams.");
  nb::class_<sim::PoseFinder>(m, "SimulatorPoses", "Exact poses of a simulated drive.")
      .def(
          "__init__",
          [](sim::PoseFinder* self, const std::string& scene, std::uint64_t seed, double speed, double traffic) {
            new (self) sim::PoseFinder(options_of(scene, seed, speed, traffic, 0));
          },
          nb::arg("scene"), nb::arg("seed"), nb::arg("speed"), nb::arg("traffic"))
      .def(
          "at",
          [](sim::PoseFinder& self, In<std::int64_t, 1> times) {
            const std::size_t n = times.shape(0);
            const std::int64_t* t = times.data();
            for (std::size_t k = 0; k < n; ++k)
              if (t[k] < 0 || t[k] > kLongestNs)
                throw lidarcodec::Error(lidarcodec::ErrorCode::Settings, "a drive lasts from 0 to 30 days");
            std::vector<double> out(n * 16);
            {
              nb::gil_scoped_release release;
              self.at(t, n, out.data());
            }
            return give(std::move(out), {n, std::size_t{4}, std::size_t{4}});
          },
          nb::arg("t_ns").noconvert(),
          "T_world_sensor float64 (N, 4, 4) at times in ns since packet 0; rising order is fast.")
      .def(
          "road_users",
          [](sim::PoseFinder& self, std::int64_t t_ns,
             double reach_m) -> Tuple<Array<std::uint8_t>, Array<std::uint32_t>, Array<double>> {
            check(t_ns >= 0 && t_ns <= kLongestNs, "a drive lasts from 0 to 30 days");
            check(reach_m > 0 && reach_m <= kMostReachM, "road users are known up to 200 m away");
            std::vector<sim::RoadUser> users;
            {
              nb::gil_scoped_release release;
              users = self.road_users(t_ns, reach_m);
            }
            std::vector<std::uint8_t> kinds;
            std::vector<std::uint32_t> ids;
            std::vector<double> numbers;
            for (const sim::RoadUser& user : users) {
              kinds.push_back(static_cast<std::uint8_t>(user.kind));
              ids.push_back(user.id);
              numbers.insert(numbers.end(), {user.at.x, user.at.y, user.at.z, user.c, user.s, user.vx, user.vy});
              numbers.insert(numbers.end(), user.lo, user.lo + 3);
              numbers.insert(numbers.end(), user.hi, user.hi + 3);
            }
            const std::size_t n = users.size();
            return nb::make_tuple(give(std::move(kinds), {n}), give(std::move(ids), {n}),
                                  give(std::move(numbers), {n, std::size_t{13}}));
          },
          nb::arg("t_ns"), nb::arg("reach_m"),
          "Road users near the sensor at a time in ns since packet 0: kinds uint8 (N,), ids uint32 (N,) and float64 "
          "(N, 13): place x y z in the world, cosine and sine of the heading, velocity x y, and the least and the "
          "greatest x y z of its parts, in its own frame.");
  nb::class_<sim::SpinningSimulator>(m, "SpinningSimulator", "Any spinning sensor on a simulated drive.")
      .def(
          "__init__",
          [](sim::SpinningSimulator* self, const std::string& scene, std::uint64_t seed, double speed, double traffic,
             const Numbers& traits, std::size_t rows) {
            check(rows > 0 && rows <= 4096, "a sensor has 1 to 4096 rows");
            sim::SimulatorOptions options;
            options.scene = scene;
            options.world = {seed, speed, traffic};
            new (self) sim::SpinningSimulator(options, traits_of(traits), rows);
          },
          nb::arg("scene"), nb::arg("seed"), nb::arg("speed"), nb::arg("traffic"), nb::arg("traits"), nb::arg("rows"))
      .def(
          "fire",
          [](sim::SpinningSimulator& self, In<std::int64_t, 2> t_ns, In<double, 3> beams,
             double far_m) -> Tuple<Counts32, Counts16, Counts16, Counts16, Counts32, Counts16, Counts16, Array<float>,
                                    Array<std::uint8_t>> {
            sim::Firings f;
            check(beams.shape(0) == 6, "beams are (6, H, W)");
            f.rows = beams.shape(1), f.columns = beams.shape(2), f.far_m = far_m;
            check(f.rows * f.columns <= kMostCells && far_m > 0, "at most 2^23 firings a call");
            f.shared = t_ns.shape(0) == 1;
            check((f.shared || t_ns.shape(0) == f.rows) && t_ns.shape(1) == f.columns, "times do not fit the beams");
            f.t_ns = t_ns.data();
            for (std::size_t k = 0; k < t_ns.size(); ++k)
              check(f.t_ns[k] >= 0 && f.t_ns[k] <= kLongestFiringNs, "a drive lasts from 0 to 31 days");
            for (std::size_t axis = 0; axis < 3; ++axis) {
              f.near[axis] = beams.data() + axis * f.rows * f.columns;
              f.far[axis] = beams.data() + (axis + 3) * f.rows * f.columns;
            }
            sim::Planes p;
            {
              nb::gil_scoped_release release;
              self.fire(f, p);
            }
            const auto shaped = [&](auto& values) { return give(std::move(values), {f.rows, f.columns}); };
            return nb::make_tuple(shaped(p.range), shaped(p.reflectivity), shaped(p.signal), shaped(p.near_ir),
                                  shaped(p.range2), shaped(p.reflectivity2), shaped(p.signal2), shaped(p.distance_m),
                                  shaped(p.label));
          },
          nb::arg("t_ns").noconvert(), nb::arg("beams").noconvert(), nb::arg("far_m"),
          "Range, reflectivity, signal, near infrared, range, reflectivity and signal of the second return, true "
          "distance "
          "and label of firings, (H, W) each. t_ns: int64 (H, W), or (1, W) if rows fire together, since the start of "
          "the drive; beams: float64 (6, H, W), x, y and z in metres of the range 0 of each beam, then of the range "
          "far_m.");
  m.def(
      "simulator_calibration",
      [] {
        std::vector<std::int32_t> out;
        for (const sim::LaserRow& r : sim::kLaserTable)
          for (const std::int16_t v :
               {r.rot_cdeg, r.vert_cdeg, r.dist_mm, r.vert_offset_mm, r.horiz_offset_mm, r.focal_mm, r.slope_tenth})
            out.push_back(v);
        return give(std::move(out), {static_cast<std::size_t>(sim::kLasers), std::size_t{7}});
      },
      "The simulated unit's calibration, int32 (64, 7): rotation, elevation [0.01 degree], distance, vertical offset, "
      "horizontal offset, focal distance [mm], focal slope [0.1].");
  m.attr("SIMULATOR_PACKET_NS") = sim::kPacketNs;
}
