#include "ranges/jpeg_writer.hpp"

#include <algorithm>
#include <bit>
#include <cmath>

#include "base/error.hpp"
#include "ranges/dct.hpp"
#include "ranges/huffman.hpp"

namespace lidarcodec {

namespace {

constexpr std::size_t kCoefficients = kSide * kSide;
constexpr std::uint8_t kEndOfBlock = 0x00, kSixteenZeros = 0xF0;
// Quantisation with a dead zone: coefficients below 0.6 steps become 0, which saves bits at an equal mean squared
// error.
constexpr float kRounding = 0.4f;

constexpr std::array<std::uint8_t, kCoefficients> make_zigzag() {
  std::array<std::uint8_t, kCoefficients> order{};
  std::size_t at = 0;
  for (std::size_t diagonal = 0; diagonal < 2 * kSide - 1; ++diagonal)
    for (std::size_t i = 0; i <= diagonal; ++i) {
      const std::size_t y = diagonal % 2 ? i : diagonal - i, x = diagonal - y;
      if (y < kSide && x < kSide) order[at++] = static_cast<std::uint8_t>(y * kSide + x);
    }
  return order;
}

constexpr auto kZigzag = make_zigzag();

struct Symbol {
  std::uint8_t name;
  std::uint8_t bits;    // extra bits
  std::uint16_t extra;  // their value
  bool first;           // the DC coefficient, which has its own table
};

Symbol symbol_of(int value, unsigned run, bool first) {
  const unsigned size = static_cast<unsigned>(std::bit_width(static_cast<unsigned>(std::abs(value))));
  const int extra = value < 0 ? value + (1 << size) - 1 : value;
  return {static_cast<std::uint8_t>(run << 4 | size), static_cast<std::uint8_t>(size),
          static_cast<std::uint16_t>(extra), first};
}

class Quantiser {
 public:
  Quantiser(const StepTable& steps, unsigned bits) : limit_(static_cast<float>((1 << (bits + 2)) - 1)) {
    for (std::size_t i = 0; i < kCoefficients; ++i) inverse_[i] = 1.0f / static_cast<float>(steps[i]);
  }
  // Levels of a block in zigzag order, clipped to what the format can write: filled holes may be larger.
  std::array<int, kCoefficients> levels(const Block& c) const {
    Block scaled;
    for (std::size_t i = 0; i < kCoefficients; ++i) {
      const float level = c[i] * inverse_[i];
      scaled[i] = !(level > -limit_) ? -limit_ : level < limit_ ? level : limit_;  // NaN: -limit
    }
    std::array<int, kCoefficients> raster, out;
    for (std::size_t i = 0; i < kCoefficients; ++i) {
      const int magnitude = static_cast<int>(std::abs(scaled[i]) + kRounding);
      raster[i] = scaled[i] < 0 ? -magnitude : magnitude;
    }
    raster[0] = static_cast<int>(std::floor(scaled[0] + 0.5f));
    for (std::size_t i = 0; i < kCoefficients; ++i) out[i] = raster[kZigzag[i]];
    return out;
  }

 private:
  float limit_;
  Block inverse_;
};

std::vector<Symbol> symbols_of(const float* samples, std::size_t rows, std::size_t width, unsigned bits,
                               const StepTable& steps) {
  const Quantiser quantiser(steps, bits);
  const float middle = static_cast<float>(1 << (bits - 1));
  std::vector<Symbol> symbols;
  symbols.reserve(rows * width / 2);
  int last_dc = 0;
  for (std::size_t y = 0; y < rows; y += kSide)
    for (std::size_t x = 0; x < width; x += kSide) {
      Block block;
      for (std::size_t i = 0; i < kSide; ++i)
        for (std::size_t j = 0; j < kSide; ++j) block[i * kSide + j] = samples[(y + i) * width + x + j] - middle;
      const auto level = quantiser.levels(forward_dct(block));
      symbols.push_back(symbol_of(level[0] - last_dc, 0, true));
      last_dc = level[0];
      unsigned run = 0;
      for (std::size_t i = 1; i < kCoefficients; ++i) {
        if (!level[i]) {
          ++run;
          continue;
        }
        for (; run >= 16; run -= 16) symbols.push_back({kSixteenZeros, 0, 0, false});
        symbols.push_back(symbol_of(level[i], run, false));
        run = 0;
      }
      if (run) symbols.push_back({kEndOfBlock, 0, 0, false});
    }
  return symbols;
}

class Writer {
 public:
  void byte(unsigned value) { bytes_.push_back(static_cast<std::uint8_t>(value)); }
  void word(std::size_t value) {
    byte(static_cast<unsigned>(value >> 8 & 0xFF));
    byte(static_cast<unsigned>(value & 0xFF));
  }
  void bits(std::uint32_t value, unsigned count) {
    pending_ = pending_ << count | value;
    for (waiting_ += count; waiting_ >= 8; waiting_ -= 8) {
      const unsigned out = static_cast<unsigned>(pending_ >> (waiting_ - 8) & 0xFF);
      byte(out);
      if (out == 0xFF) byte(0);  // byte stuffing: data must not look like a marker
    }
  }
  void pad() {
    if (waiting_) bits((1u << (8 - waiting_)) - 1, 8 - waiting_);
  }
  void table(unsigned kind, const HuffmanTable& t) {
    word(0xFFC4);
    word(3 + kMaxCodeBits + t.symbols.size());
    byte(kind);
    for (std::size_t i = 1; i <= kMaxCodeBits; ++i) byte(t.count[i]);
    bytes_.insert(bytes_.end(), t.symbols.begin(), t.symbols.end());
  }
  void steps(const StepTable& s) {
    const bool wide = *std::max_element(s.begin(), s.end()) > 0xFF;
    word(0xFFDB);
    word(3 + kCoefficients * (wide ? 2 : 1));
    byte(wide ? 0x10 : 0x00);
    for (std::uint8_t i : kZigzag) wide ? word(s[i]) : byte(s[i]);
  }
  std::vector<std::uint8_t> done() { return std::move(bytes_); }

 private:
  std::vector<std::uint8_t> bytes_;
  std::uint64_t pending_ = 0;
  unsigned waiting_ = 0;
};

}  // namespace

std::vector<std::uint8_t> write_jpeg(const float* samples, std::size_t rows, std::size_t width, unsigned bits,
                                     const StepTable& steps) {
  if (!rows || !width || rows % kSide || width % kSide || rows > 65528 || width > 65528)
    throw Error(ErrorCode::Settings, "a JPEG has sides that are multiples of 8, from 8 to 65528");
  if (bits != 8 && bits != 12) throw Error(ErrorCode::Settings, "a JPEG has 8 or 12 bits a sample");
  if (std::find(steps.begin(), steps.end(), 0) != steps.end())
    throw Error(ErrorCode::Settings, "a JPEG has no step of 0");
  const auto symbols = symbols_of(samples, rows, width, bits, steps);
  std::array<std::uint32_t, kSymbols> dc_counts{}, ac_counts{};
  for (const Symbol& s : symbols) ++(s.first ? dc_counts : ac_counts)[s.name];
  if (std::all_of(ac_counts.begin(), ac_counts.end(), [](std::uint32_t n) { return n == 0; }))
    ac_counts[kEndOfBlock] = 1;
  const HuffmanTable dc = best_table(dc_counts), ac = best_table(ac_counts);

  Writer out;
  out.word(0xFFD8);
  out.steps(steps);
  out.word(0xFFC1);  // extended sequential: both depths, and 16-bit steps
  out.word(11);
  out.byte(bits);
  out.word(rows);
  out.word(width);
  for (unsigned b : {1u, 1u, 0x11u, 0u}) out.byte(b);  // one component: number, no subsampling, table of steps 0
  out.table(0x00, dc);
  out.table(0x10, ac);
  out.word(0xFFDA);
  out.word(8);
  for (unsigned b : {1u, 1u, 0u, 0u, 63u, 0u}) out.byte(b);  // that component, tables 0, all coefficients
  for (const Symbol& s : symbols) {
    const HuffmanTable& t = s.first ? dc : ac;
    out.bits(t.code[s.name], t.bits[s.name]);
    if (s.bits) out.bits(s.extra, s.bits);
  }
  out.pad();
  out.word(0xFFD9);
  return out.done();
}

}  // namespace lidarcodec
