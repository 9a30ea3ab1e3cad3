// Huffman tables as JPEG defines them (ITU-T T.81, K.2): codes of at most 16 bits, none of them all ones.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lidarcodec {

inline constexpr std::size_t kSymbols = 256;
inline constexpr std::size_t kMaxCodeBits = 16;

struct HuffmanTable {
  std::array<std::uint8_t, kMaxCodeBits + 1> count{};  // codes of each length, as a DHT segment lists them
  std::vector<std::uint8_t> symbols;                   // by code
  std::array<std::uint16_t, kSymbols> code{};
  std::array<std::uint8_t, kSymbols> bits{};  // 0: the symbol has no code
};

// The table with the fewest bits for these counts of symbols, of which one or more is not 0.
HuffmanTable best_table(const std::array<std::uint32_t, kSymbols>& occurs);

}  // namespace lidarcodec
