// *Symbols*: the numbers of the intensities that occur in a frame, in rising order. A section begins with these
// intensities and their classes. Classes have about equal numbers of returns, so that contexts have, too.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "bits/bitmodel.hpp"

namespace lidarcodec {

inline constexpr std::size_t kMassClasses = 48;
inline constexpr std::uint16_t kNoSymbol = 0x100;

struct Symbols {
  std::vector<std::uint8_t> value;           // of each symbol, rising
  std::vector<std::uint8_t> mass_class;      // of each symbol, never falling, below kMassClasses
  std::array<std::uint8_t, 256> of_value{};  // symbol of a value in use
  int depth = 0;                             // of the binary tree whose leaves are the symbols: 1 to 8
  std::array<std::uint8_t, 256> leaf{};      // of each symbol; spread evenly
  std::array<std::uint16_t, 256> of_leaf{};  // symbol of a leaf, or kNoSymbol

  std::size_t count() const { return value.size(); }

  // Sets the other fields from value, which has two or more elements, and mass_class.
  void place() {
    const std::size_t n = count();
    for (depth = 1; (std::size_t{1} << depth) < n; ++depth) {
    }
    of_leaf.fill(kNoSymbol);
    for (std::size_t s = 0; s < n; ++s) {
      of_value[value[s]] = static_cast<std::uint8_t>(s);
      leaf[s] = static_cast<std::uint8_t>((s << depth) / n);
      of_leaf[leaf[s]] = static_cast<std::uint16_t>(s);
    }
  }
};

// The symbols of a histogram, and of values that may come. The class of a symbol is the quantile of the middle of its
// returns.
inline Symbols symbols_of(const std::array<std::size_t, 256>& returns_of_value,
                          const std::array<bool, 256>& may_come = {}) {
  std::size_t total = 0, before = 0;
  for (const std::size_t returns : returns_of_value) total += returns;
  Symbols symbols;
  for (std::size_t value = 0; value < 256; ++value) {
    const std::size_t returns = returns_of_value[value];
    if (returns == 0 && !may_come[value]) continue;
    symbols.value.push_back(static_cast<std::uint8_t>(value));
    const std::size_t mass_class = (2 * before + returns) * kMassClasses / (2 * total);  // kMassClasses behind the last
    symbols.mass_class.push_back(static_cast<std::uint8_t>(mass_class < kMassClasses ? mass_class : kMassClasses - 1));
    before += returns;
  }
  return symbols;
}

// Writes or reads value and mass_class, by BitWriter or BitReader (bits/rangecoder.hpp).
template <class Bits>
void code_symbols(Bits& bits, Symbols& symbols) {
  const auto code = [&bits](bool bit, BitModel& model) {
    const bool is = bits.bit(bit, model.probability());
    model.update(is);
    return is;
  };
  std::array<BitModel, 8> used;  // context: which of the three values before are in use
  std::uint32_t recent = 0;
  std::size_t count = 0;
  for (std::uint32_t value = 0; value < 256; ++value) {
    const bool next = !Bits::kReads && count < symbols.count() && symbols.value[count] == value;
    const bool is_used = code(next, used[recent]);
    if (Bits::kReads && is_used) symbols.value.push_back(static_cast<std::uint8_t>(value));
    count += is_used;
    recent = (recent << 1 | static_cast<std::uint32_t>(is_used)) & 7u;
  }
  if (Bits::kReads) symbols.mass_class.resize(count);
  std::array<BitModel, 2> rise;  // context: whether the decision before was a one
  std::uint8_t mass_class = 0;
  bool rises = false;
  for (std::uint8_t& of_symbol : symbols.mass_class) {
    while (mass_class < kMassClasses - 1) {
      rises = code(!Bits::kReads && of_symbol > mass_class, rise[rises]);
      if (!rises) break;
      ++mass_class;
    }
    of_symbol = mass_class;
  }
}

}  // namespace lidarcodec
