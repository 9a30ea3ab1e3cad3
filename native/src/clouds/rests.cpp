#include "clouds/rests.hpp"

#include "base/varint.hpp"

namespace lidarcodec {
namespace {

// Bits one after the other, in bytes from the lowest bit on.
class BitsBeside {
 public:
  void put(std::uint32_t value, std::uint32_t bits) {
    held_ |= std::uint64_t{value} << held_bits_;
    for (held_bits_ += bits; held_bits_ >= 8; held_bits_ -= 8, held_ >>= 8)
      bytes_.push_back(static_cast<std::uint8_t>(held_));
  }
  const std::vector<std::uint8_t>& finish() {
    if (held_bits_ > 0) bytes_.push_back(static_cast<std::uint8_t>(held_));
    held_bits_ = 0;
    return bytes_;
  }

 private:
  std::vector<std::uint8_t> bytes_;
  std::uint64_t held_ = 0;
  std::uint32_t held_bits_ = 0;
};

}  // namespace

std::vector<std::uint8_t> RestWriter::finish() const {
  std::uint32_t most = 0;
  for (const std::uint32_t rest : rests_) most = std::max(most, rest);
  std::vector<std::uint8_t> out;
  if (most == 0) return {0};
  const std::uint32_t tokens = token_of(most) + 1;
  std::array<std::unique_ptr<RestTable>, kMostRestContexts> tables;
  struct Part {
    std::uint16_t start, frequency;
  };
  std::vector<Part> parts(rests_.size());
  BitsBeside beside;
  for (std::size_t i = 0; i < rests_.size(); ++i) {
    const std::uint32_t token = token_of(rests_[i]);
    std::unique_ptr<RestTable>& known = tables[contexts_[i]];
    if (known == nullptr) known = std::make_unique<RestTable>(tokens);
    RestTable& table = *known;
    parts[i] = {static_cast<std::uint16_t>(table.start(token)), static_cast<std::uint16_t>(table.frequency(token))};
    table.take(token);
    if (const std::uint32_t bits = bits_beside(token)) beside.put(rests_[i] - (std::uint32_t{1} << bits), bits);
  }
  std::array<std::uint32_t, RestReader::kLanes> states;
  states.fill(RestReader::kLeast);
  std::vector<std::uint16_t> words;  // the last one is read first
  for (std::size_t i = parts.size(); i-- > 0;) {
    std::uint32_t& state = states[i % RestReader::kLanes];
    const std::uint32_t frequency = parts[i].frequency;
    if (std::uint64_t{state} >= std::uint64_t{frequency} << (32 - kFrequencyBits)) {
      words.push_back(static_cast<std::uint16_t>(state));
      state >>= 16;
    }
    state = (state / frequency << kFrequencyBits) + state % frequency + parts[i].start;
  }
  out.push_back(static_cast<std::uint8_t>(tokens));
  for (const std::uint32_t state : states)
    for (std::uint32_t shift = 0; shift < 32; shift += 8) out.push_back(static_cast<std::uint8_t>(state >> shift));
  put_number(out, words.size());
  for (std::size_t i = words.size(); i-- > 0;) {
    out.push_back(static_cast<std::uint8_t>(words[i]));
    out.push_back(static_cast<std::uint8_t>(words[i] >> 8));
  }
  const std::vector<std::uint8_t>& more = beside.finish();
  out.insert(out.end(), more.begin(), more.end());
  return out;
}

RestReader::RestReader(Bytes data) {
  VarintReader reader(data, "rests");
  tokens_ = reader.byte();
  if (tokens_ > kMostTokens) throw Error(ErrorCode::Section, "rests of " + std::to_string(tokens_) + " tokens");
  if (tokens_ == 0) {
    reader.end();
    return;
  }
  for (std::uint32_t& state : states_) state = static_cast<std::uint32_t>(little_endian(reader.take(4), 0, 4));
  const Bytes words = reader.take(2 * reader.number(reader.left() / 2));
  for (std::size_t at = 0; at < words.size(); at += 2)
    words_.push_back(static_cast<std::uint16_t>(little_endian(words, at, 2)));
  words_.push_back(0);
  bits_ = reader.rest();
}

void RestReader::begin(std::uint8_t context) {
  tables_[context] = std::make_unique<RestTable>(tokens_);
  tables_[context]->look_up_too();
}

std::uint32_t RestReader::beside(std::uint32_t token) {
  const std::uint32_t bits = bits_beside(token);
  for (; held_bits_ < bits; held_bits_ += 8) {
    if (bits_.empty()) ends();
    held_ |= std::uint64_t{bits_[0]} << held_bits_;
    bits_ = bits_.subspan(1);
  }
  const std::uint32_t highest = std::uint32_t{1} << bits;
  const std::uint32_t found = highest | (static_cast<std::uint32_t>(held_) & (highest - 1));
  held_ >>= bits;
  held_bits_ -= bits;
  return found;
}

void RestReader::finish() const {
  const bool begins = std::all_of(states_.begin(), states_.end(), [](std::uint32_t state) { return state == kLeast; });
  if (tokens_ != 0 && (!begins || word_ + 1 != words_.size() || !bits_.empty() || held_ != 0))
    throw Error(ErrorCode::Section, "the end of rests does not fit what was read");
}

void RestReader::ends() { throw Error(ErrorCode::Truncated, "rests that end too early"); }

}  // namespace lidarcodec
