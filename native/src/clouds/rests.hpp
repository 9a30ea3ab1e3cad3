// Rests: what predictions of the numbers of points leave, coded by asymmetric numeral systems (Duda, "Asymmetric
// numeral systems", 2013) with tables that follow what came before. docs/wire-format-clouds.md ("Rests") has the
// format.
#pragma once
#include <memory>
#include <optional>
#include <span>

#include "base/varint.hpp"
#include "clouds/rest_tables.hpp"

namespace lidarcodec {

// Rests that were found, and what is known of each before it: a context below kMostRestContexts.
class RestWriter {
 public:
  void add(std::uint32_t rest, std::uint8_t context) {
    rests_.push_back(rest);
    contexts_.push_back(context);
  }
  void reserve(std::size_t count) {
    rests_.reserve(count);
    contexts_.reserve(count);
  }
  // The bytes of all of them. Each is kMostRest at most.
  std::vector<std::uint8_t> finish() const;

 private:
  std::vector<std::uint32_t> rests_;
  std::vector<std::uint8_t> contexts_;
};

// The rests of such bytes, one after the other, with the same contexts.
class RestReader {
 public:
  // Raises Section or Truncated.
  explicit RestReader(Bytes data);

  // Raises Truncated, if the bytes hold fewer.
  std::uint32_t next(std::uint8_t context) {
    if (tokens_ == 0) return 0;
    if (tables_[context] == nullptr) [[unlikely]]
      begin(context);
    RestTable& table = *tables_[context];
    std::uint32_t& state = states_[at_++ % kLanes];
    const std::uint32_t slot = state % kFrequencies, token = table.token_at(slot);
    state = table.frequency(token) * (state >> kFrequencyBits) + slot - table.start(token);
    const bool moves = state < kLeast;  // added and chosen, because a branch would often be mispredicted
    const std::uint32_t moved = state << 16 | words_[word_];
    state = moves ? moved : state;
    word_ += moves;
    if (word_ == words_.size()) [[unlikely]]
      ends();
    table.take(token);
    return token < kDirectTokens ? token : beside(token);
  }

  // Raises Section unless all bytes were used as an encoder uses them.
  void finish() const;

 private:
  friend class RestWriter;
  static constexpr std::size_t kLanes = 4;
  static constexpr std::uint32_t kLeast = 1u << 16;

  std::uint32_t beside(std::uint32_t token);
  void begin(std::uint8_t context);
  [[noreturn]] static void ends();

  std::uint32_t tokens_;
  std::size_t at_ = 0;
  std::array<std::uint32_t, kLanes> states_{};
  std::vector<std::uint16_t> words_;  // and one more, which is never used up
  std::size_t word_ = 0;
  Bytes bits_;
  std::uint64_t held_ = 0;
  std::uint32_t held_bits_ = 0;
  std::array<std::unique_ptr<RestTable>, kMostRestContexts> tables_;
};

}  // namespace lidarcodec
