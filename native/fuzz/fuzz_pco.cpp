// libFuzzer: any bytes as ranges of codec pcodec, and as a chunk of pco. What is read takes no more memory than its
// returns do, and bytes are read or refused.
#include <cstdlib>

#include "base/error.hpp"
#include "parts/fuzz_input.hpp"
#include "pco/groups.hpp"
#include "pco/pco.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzInput input(data, size);
  const bool grouped = input.byte() % 2 == 0;
  const std::size_t count = input.below(2000);
  const std::vector<std::uint8_t> rest = input.rest();
  try {
    if (grouped) {
      if (lidarcodec::decode_pco_groups(rest.data(), rest.size(), count).size() != count) std::abort();
    } else {
      lidarcodec::PcoReader pco(rest.data(), rest.size());
      std::vector<std::int16_t> numbers(count);
      pco.read_chunk(numbers.data(), count);
      if (pco.bytes_read() > rest.size()) std::abort();
    }
  } catch (const lidarcodec::Error&) {
  }
  return 0;
}
