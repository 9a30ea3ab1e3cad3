#include <nanobind/stl/string.h>
#include <nanobind/stl/unique_ptr.h>

#include <cmath>

#include "base/error.hpp"
#include "bindings.hpp"
#include "simulator/simulator.hpp"

namespace {

namespace sim = lidarcodec::sim;

constexpr std::size_t kMostPackets = 100'000;
constexpr std::uint64_t kMostSkipped = 9'000'000'000;  // 30 days
constexpr std::int64_t kLongestNs = std::int64_t{30} * 86400 * 1'000'000'000;

sim::SimulatorOptions options_of(const std::string& scene, std::uint64_t seed, double speed, double traffic,
                                 std::int64_t start_ns) {
  sim::SimulatorOptions options;
  options.scene = scene;
  options.world = {seed, speed, traffic};
  options.start_ns = start_ns;
  return options;
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
          "T_world_sensor float64 (N, 4, 4) at times in ns since packet 0; rising order is fast.");
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
