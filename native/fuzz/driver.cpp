// Runs a libFuzzer harness where there is no libFuzzer: random inputs of random lengths, for so many seconds.
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

// SplitMix64 (Steele, Lea, Flood 2014).
std::uint64_t next(std::uint64_t& state) {
  std::uint64_t z = (state += 0x9E3779B97F4A7C15u);
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}

}  // namespace

int main(int count, char** words) {
  const long seconds = count > 1 ? std::atol(words[1]) : 10;
  std::uint64_t state = count > 2 ? static_cast<std::uint64_t>(std::atoll(words[2])) : 1;
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(seconds);
  unsigned long cases = 0;
  std::vector<std::uint8_t> data;
  for (; std::chrono::steady_clock::now() < end; ++cases) {
    data.resize(next(state) % (std::uint64_t{1} << (next(state) % 17)));
    // Half of the inputs are mostly zeros: headers with small counts reach further than noise does.
    const bool sparse = (next(state) & 1u) != 0;
    for (auto& byte : data) byte = sparse && next(state) % 8 != 0 ? 0 : static_cast<std::uint8_t>(next(state));
    LLVMFuzzerTestOneInput(data.data(), data.size());
  }
  std::printf("%lu random inputs in %ld s\n", cases, seconds);
}
