#include "pco/pco.hpp"

#include <algorithm>
#include <array>
#include <string>

namespace lidarcodec {
namespace {

constexpr unsigned kVersion = 4;  // major; all minor versions of it are read, as far as their modes are
constexpr unsigned kMostSizeLog = 14, kNumberBits = 16, kOffsetBitsBits = 5;
constexpr std::size_t kBatch = 256;
constexpr std::size_t kMostBatchBytes = kBatch * (kMostSizeLog + kNumberBits) / 8 + 2 * sizeof(std::uint64_t);
constexpr std::array<const char*, 5> kModes = {"Classic", "IntMult", "FloatMult", "FloatQuant", "Dict"};
constexpr std::array<const char*, 4> kDeltas = {"None", "Consecutive", "Lookback", "Conv1"};

struct Bin {
  std::uint32_t weight;
  std::uint16_t lower;
  std::uint8_t offset_bits;
};

template <std::size_t Count>
[[noreturn]] void refuse(const char* what, std::uint32_t number, const std::array<const char*, Count>& names,
                         std::size_t at) {
  const std::string name = number < Count ? names[number] : std::to_string(number);
  throw Error(ErrorCode::Section,
              std::string("pco data with ") + what + " " + name + ": " + names[0] + " alone is read here", at);
}

}  // namespace

PcoReader::PcoReader(const std::uint8_t* data, std::size_t size) : bits_(data, size) {
  const std::uint32_t major = bits_.take(8);
  bits_.take(8);  // minor
  bits_.check();
  if (major != kVersion)
    throw Error(ErrorCode::Section,
                "pco data of version " + std::to_string(major) + ": " + std::to_string(kVersion) + " is read here");
}

// Spreads the bins over the states as pco does: one after the other, each state an odd stride of about three fifths of
// the table behind the one before. A state's next states are then as in any tANS (Duda 2009): of a bin of weight w they
// begin with those of w, w + 1, ... 2 w - 1, shifted until they are in the table's range.
void PcoReader::read_bins() {
  size_log_ = bits_.take(4);
  const std::uint32_t count = bits_.take(15);
  bits_.check();
  const std::uint32_t size = 1u << size_log_;
  if (size_log_ > kMostSizeLog || count > size || (count < 2 && size_log_ > 0))
    throw Error(ErrorCode::Section,
                "pco data with " + std::to_string(count) + " bins in a table of " + std::to_string(size),
                bits_.bytes_read());
  std::vector<Bin> bins(count);
  std::uint32_t sum = 0;
  for (Bin& bin : bins) {
    bin.weight = bits_.take(size_log_) + 1;
    bin.lower = static_cast<std::uint16_t>(bits_.take(kNumberBits));
    bin.offset_bits = static_cast<std::uint8_t>(bits_.take(kOffsetBitsBits));
    bits_.check();
    if (bin.offset_bits > kNumberBits)
      throw Error(ErrorCode::Section, "a bin of pco data with offsets of more than 16 bits", bits_.bytes_read());
    sum += bin.weight;
  }
  if (count > 0 && sum != size)
    throw Error(ErrorCode::Section, "bins of pco data whose weights do not add up to its table", bits_.bytes_read());
  bits_.align();

  std::vector<std::uint32_t> bin_of(size);
  const std::uint32_t stride = 3 * size / 5 | 1u;
  std::uint32_t at = 0;
  for (std::uint32_t b = 0; b < count; ++b)
    for (std::uint32_t i = 0; i < bins[b].weight; ++i, at += stride) bin_of[at & (size - 1)] = b;
  table_.clear();
  if (count == 0) return;
  table_.resize(size);
  for (std::uint32_t s = 0; s < size; ++s) {
    Bin& bin = bins[bin_of[s]];
    unsigned shift = 0;
    while (bin.weight << shift < size) ++shift;
    table_[s] = {static_cast<std::uint16_t>((bin.weight << shift) - size), bin.lower, static_cast<std::uint8_t>(shift),
                 bin.offset_bits};
    ++bin.weight;
  }
}

// Where a batch's bits surely are in the data they are read without a look at its end.
template <bool Inside>
void PcoReader::read_batch(std::int16_t* numbers, std::size_t count) {
  std::array<std::uint32_t, kBatch> begins;  // of each offset, in bits
  std::array<std::uint16_t, kBatch> offset_bits;
  std::array<std::uint16_t, kBatch> lower;
  BitReader bits = bits_;  // a copy: what loops write would else have to be told from it
  const State* const table = table_.data();
  std::array<std::uint32_t, 4> state = states_;
  std::uint32_t sum = 0;
  const auto step = [&](std::size_t i, std::size_t j, std::uint64_t& word) {
    const State found = table[state[j]];
    lower[i] = found.lower;
    offset_bits[i] = found.offset_bits;
    begins[i] = sum;
    sum += found.offset_bits;
    state[j] = found.next + static_cast<std::uint32_t>(word & ((1u << found.bits) - 1));
    word >>= found.bits;
    return std::size_t{found.bits};
  };
  std::size_t done = 0;
  for (; done + 4 <= count; done += 4) {  // four states take 56 bits at most
    std::uint64_t word = bits.peek<Inside>();
    std::size_t used = step(done, 0, word);
    used += step(done + 1, 1, word);
    used += step(done + 2, 2, word);
    used += step(done + 3, 3, word);
    bits.skip(used);
  }
  std::uint64_t word = bits.peek<Inside>();
  for (std::size_t j = 0; done < count; ++done, ++j) bits.skip(step(done, j, word));
  states_ = state;
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint64_t offset = bits.peek<Inside>(begins[i]) & ((1u << offset_bits[i]) - 1);
    numbers[i] = static_cast<std::int16_t>(static_cast<std::uint16_t>((lower[i] + offset) ^ 0x8000u));
  }
  bits.skip(sum);
  bits.check();
  bits_ = bits;
}

void PcoReader::read_chunk(std::int16_t* numbers, std::size_t count) {
  const std::uint32_t mode = bits_.take(4);
  bits_.check();
  if (mode != 0) refuse("mode", mode, kModes, bits_.bytes_read());
  if (const std::uint32_t delta = bits_.take(4); delta != 0)
    refuse("delta encoding", delta, kDeltas, bits_.bytes_read());
  read_bins();
  if (table_.empty() && count > 0) throw Error(ErrorCode::Section, "pco data without bins", bits_.bytes_read());
  for (std::uint32_t& state : states_) state = bits_.take(size_log_);
  bits_.align();
  for (std::size_t done = 0; done < count; done += kBatch) {
    const bool inside = bits_.bytes_left() >= kMostBatchBytes;
    inside ? read_batch<true>(numbers + done, std::min(kBatch, count - done))
           : read_batch<false>(numbers + done, std::min(kBatch, count - done));
  }
  bits_.align();
}

}  // namespace lidarcodec
