#include "bits/numbers.hpp"

#include <memory>

#include "bits/rangecoder.hpp"

namespace lidarcodec {
namespace {

template <class Bits, class Value>
void code_streams(Bits& bits, Value* values, const std::vector<std::size_t>& counts) {
  for (const std::size_t count : counts) {
    const auto model = std::make_unique<NumberModel>();
    for (std::size_t i = 0; i < count; ++i, ++values) {
      if constexpr (Bits::kReads) {
        *values = model->code(bits, 0);
      } else {
        model->code(bits, *values);
      }
    }
  }
  bits.finish();
}

}  // namespace

std::vector<std::uint8_t> encode_numbers(const std::uint64_t* values, const std::vector<std::size_t>& counts) {
  std::vector<std::uint8_t> out;
  BitWriter bits(out);
  code_streams(bits, values, counts);
  return out;
}

std::vector<std::uint64_t> decode_numbers(const std::uint8_t* data, std::size_t size,
                                          const std::vector<std::size_t>& counts) {
  std::size_t total = 0;
  for (const std::size_t count : counts) total += count;
  std::vector<std::uint64_t> values(total);
  BitReader bits(data, size);
  code_streams(bits, values.data(), counts);
  return values;
}

}  // namespace lidarcodec
