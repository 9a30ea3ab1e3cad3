// Huffman tables as JPEG defines them: at most 16 bits a code, and no code of all ones.
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

// The best table for symbols that occur this often. At least one must occur.
HuffmanTable best_table(const std::array<std::uint32_t, kSymbols>& occurs);

}  // namespace lidarcodec
