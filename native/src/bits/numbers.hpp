// Adaptive coder of whole numbers, after the gamma code of Elias (1975): the length of a number in unary and its two
// bits after the first by adaptive models, the other bits with the probability 1/2.
#pragma once
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bits/bitmodel.hpp"

namespace lidarcodec {

// The models of one stream of numbers. The context of a length: how many of the last two numbers were not 0.
class NumberModel {
 public:
  // Encodes `value`, or decodes and returns one.
  template <class Bits>
  std::uint64_t code(Bits& bits, std::uint64_t value) {
    const int wanted = static_cast<int>(std::bit_width(value));
    std::array<BitModel, kLengths>& longer = longer_[context_];
    int length = 0;
    for (; length < static_cast<int>(kLengths); ++length) {
      BitModel& model = longer[static_cast<std::size_t>(length)];
      const bool more = bits.bit(wanted > length, model.probability());
      model.update(more);
      if (!more) break;
    }
    std::uint64_t result = length > 0;
    int left = length - 1;
    for (std::size_t node = 1; left > 0 && node < 4; --left) {
      BitModel& model = high_[static_cast<std::size_t>(length - 1)][node];
      const bool bit = bits.bit((value >> (left - 1)) & 1u, model.probability());
      model.update(bit);
      node = node << 1 | static_cast<std::size_t>(bit);
      result = result << 1 | static_cast<std::uint64_t>(bit);
    }
    if (left > 0) result = result << left | (bits.bits(value, left) & ((std::uint64_t{1} << left) - 1));
    context_ = static_cast<std::size_t>((length > 0) + last_nonzero_);
    last_nonzero_ = length > 0;
    return result;
  }

 private:
  static constexpr std::size_t kLengths = 64;  // bits of a number
  std::array<std::array<BitModel, kLengths>, 3> longer_;
  std::array<std::array<BitModel, 4>, kLengths> high_;
  std::size_t context_ = 0;
  bool last_nonzero_ = false;
};

// Several streams of numbers in one, each with its own models; counts: the numbers in each.
std::vector<std::uint8_t> encode_numbers(const std::uint64_t* values, const std::vector<std::size_t>& counts);

// All numbers of all streams. Raises Section or Truncated. Takes 8 bytes a number: check the counts first.
std::vector<std::uint64_t> decode_numbers(const std::uint8_t* data, std::size_t size,
                                          const std::vector<std::size_t>& counts);

}  // namespace lidarcodec
