// Reader of numerical data in pco's wrapped format (pcodec's docs/format.md), as far as codec `pcodec` uses it: numbers
// of 16 bits, mode Classic, no delta encoding, one page in each chunk. All else is refused by name.
//
// A number is a bin, coded by tANS, and an offset into it. Bins of 256 numbers come first, then their offsets.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "pco/bit_reader.hpp"

namespace lidarcodec {

class PcoReader {
 public:
  // Reads the header. Raises Truncated, or Section for a version that is not read here.
  PcoReader(const std::uint8_t* data, std::size_t size);

  // Reads a chunk of one page with exactly `count` numbers of type i16 into `numbers`. Raises Section or Truncated.
  void read_chunk(std::int16_t* numbers, std::size_t count);

  // Bytes read so far.
  std::size_t bytes_read() const { return bits_.bytes_read(); }

 private:
  // What a state of tANS stands for, and where the next one is: `next` and as many bits as `bits` says.
  struct alignas(8) State {
    std::uint16_t next, lower;
    std::uint8_t bits, offset_bits;
  };

  void read_bins();
  template <bool Inside>
  void read_batch(std::int16_t* numbers, std::size_t count);

  BitReader bits_;
  unsigned size_log_ = 0;
  std::vector<State> table_;
  std::array<std::uint32_t, 4> states_{};
};

}  // namespace lidarcodec
