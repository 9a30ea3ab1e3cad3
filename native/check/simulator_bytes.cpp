// Writes the bytes of a short simulated drive to standard output, without Python: a test builds this with every
// compiler and optimisation at hand and compares. Usage: simulator_bytes SCENE SEED SKIP PACKETS
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "simulator/simulator.hpp"

int main(int argc, char** argv) {
  if (argc != 5) return 2;
  lidarcodec::sim::SimulatorOptions options;
  options.scene = argv[1];
  options.world.seed = std::strtoull(argv[2], nullptr, 10);
  options.start_ns = 1'767'225'600'000'000'000;
  lidarcodec::sim::Simulator simulator(options);
  simulator.skip(std::strtoull(argv[3], nullptr, 10));
  const std::size_t count = std::strtoull(argv[4], nullptr, 10);
  std::vector<std::uint8_t> bytes(count * lidarcodec::sim::kPacketBytes);
  simulator.packets(count, bytes.data());
  return std::fwrite(bytes.data(), 1, bytes.size(), stdout) == bytes.size() ? 0 : 1;
}
