#include "session/frames/rest.hpp"

#include <algorithm>
#include <map>

#include "base/varint.hpp"
#include "bits/number_series.hpp"
#include "bits/numbers.hpp"
#include "session/frames/names.hpp"

namespace lidarcodec {
namespace {

constexpr std::uint64_t kMostHostStep = 1'000'000'000, kMostSeries = 64, kMostName = 32,
                        kMostSeriesNumbers = 64 * kMostColumns;
constexpr std::uint64_t kMostLevel = std::uint64_t{1} << 62, kMostRate = std::uint64_t{1} << 45;
constexpr std::int64_t kWidest = std::int64_t{1} << 60, kMostOddBytes = 65'507;
constexpr std::size_t kMostOddTotal = 32u << 20;
constexpr std::uint8_t kByLine = 0, kPlain = 1, kDifferences = 1;

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

std::int64_t sum(std::int64_t a, std::int64_t b) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) + static_cast<std::uint64_t>(b));
}

// Each number becomes the sum of itself and all those 1, 2, ... times `lag` before it, modulo 2^64.
void add_up(std::vector<std::int64_t>& values, std::size_t from, std::size_t lag) {
  for (std::size_t i = from + lag; i < values.size(); ++i) values[i] = sum(values[i], values[i - lag]);
}

std::string name(VarintReader& reader) {
  const Bytes found = reader.take(reader.number(kMostName));
  if (!is_plain_name(found)) damaged("a name that is not of letters, digits and underscores");
  return {found.begin(), found.end()};
}

std::vector<std::uint64_t> series_values(VarintReader& reader, std::size_t bytes, std::size_t count,
                                         const Outside& outside) {
  const std::uint8_t kind = reader.byte();
  std::vector<std::uint64_t> values;
  if (kind == kPlain) {
    const std::vector<std::uint8_t> plain = zstd_frame(outside, reader.sized(), count * bytes);
    for (std::size_t i = 0; i < count; ++i) values.push_back(little_endian(plain, i * bytes, bytes));
    return values;
  }
  if (kind != kByLine) damaged("a series of unknown kind " + std::to_string(kind));
  const std::int64_t most = bytes == 8 ? kWidest : (std::int64_t{1} << (8 * bytes)) - 1;
  for (const std::int64_t value : read_line(reader, count)) {
    if (value < 0 || value > most) damaged("a series with numbers that do not fit");
    values.push_back(static_cast<std::uint64_t>(value));
  }
  return values;
}

// Packets of so many bytes, one after the other.
std::vector<std::uint8_t> packets_of_size(VarintReader& reader, std::size_t count, std::size_t size,
                                          const Outside& outside) {
  const std::uint8_t kind = reader.byte();
  if (kind > kDifferences) damaged("odd packets of unknown kind " + std::to_string(kind));
  std::vector<std::uint8_t> plain = zstd_frame(outside, reader.sized(), count * size);
  if (kind == kDifferences)
    for (std::size_t i = size; i < plain.size(); ++i) plain[i] = static_cast<std::uint8_t>(plain[i] + plain[i - size]);
  return plain;
}

void read_odd(VarintReader& reader, std::size_t packets, const Outside& outside, PacketRest& rest) {
  const std::size_t count = reader.number(packets);
  if (count == 0) return;
  std::vector<std::int64_t> places = signed_numbers(reader.sized(), {count, count});
  std::vector<std::int64_t> sizes(places.begin() + static_cast<std::ptrdiff_t>(count), places.end());
  places.resize(count);
  add_up(places, 0, 1);
  add_up(sizes, 0, 1);
  std::map<std::size_t, std::vector<std::size_t>> of_size;
  std::size_t total = 0;
  for (std::size_t i = 0; i < count; ++i) {
    if (places[i] < 0 || places[i] >= static_cast<std::int64_t>(packets) || (i > 0 && places[i] <= places[i - 1]))
      damaged("odd packets at places that are not ascending, or beyond the " + std::to_string(packets) +
              " of the frame");
    if (sizes[i] < 0 || sizes[i] > kMostOddBytes) damaged("an odd packet of more bytes than any packet has");
    const auto size = static_cast<std::size_t>(sizes[i]);
    total += size;
    rest.odd.push_back(static_cast<std::uint16_t>(places[i]));
    if (size > 0) of_size[size].push_back(i);
  }
  if (total > kMostOddTotal) damaged("odd packets of " + std::to_string(total) + " bytes");
  rest.odd_packets.resize(count);
  for (const auto& [size, numbers] : of_size) {
    const std::vector<std::uint8_t> plain = packets_of_size(reader, numbers.size(), size, outside);
    auto from = plain.begin();
    for (const std::size_t number : numbers) {
      rest.odd_packets[number].assign(from, from + static_cast<std::ptrdiff_t>(size));
      from += static_cast<std::ptrdiff_t>(size);
    }
  }
}

}  // namespace

std::vector<std::int64_t> signed_numbers(Bytes data, const std::vector<std::size_t>& counts) {
  std::vector<std::int64_t> values;
  for (const std::uint64_t number : decode_numbers(data.data(), data.size(), counts))
    values.push_back(static_cast<std::int64_t>(number >> 1) ^ -static_cast<std::int64_t>(number & 1));
  return values;
}

std::vector<std::int64_t> read_line(VarintReader& reader, std::size_t count) {
  const std::uint8_t form = reader.byte();
  if (form > static_cast<std::uint8_t>(SeriesForm::Alternating))
    damaged("a series of unknown form " + std::to_string(form));
  const std::int64_t level = reader.signed_number(kMostLevel), rate = reader.signed_number(kMostRate);
  std::vector<std::int64_t> values = signed_numbers(reader.sized(), {count});
  const auto kind = static_cast<SeriesForm>(form);
  if (kind == SeriesForm::Second) add_up(values, 1, 1);
  if (kind == SeriesForm::First || kind == SeriesForm::Second) add_up(values, 0, 1);
  if (kind == SeriesForm::Alternating) add_up(values, 0, 2);
  for (std::size_t i = 0; i < values.size(); ++i) {
    const auto risen = static_cast<std::int64_t>(i * static_cast<std::uint64_t>(rate));
    values[i] = sum(values[i], sum(level, risen >> 10));
  }
  return values;
}

std::vector<std::size_t> PacketRest::regular() const {
  std::vector<std::size_t> places;
  auto next = odd.begin();
  for (std::size_t place = 0; place < packet_ns.size(); ++place)
    if (next != odd.end() && *next == place)
      ++next;
    else
      places.push_back(place);
  return places;
}

PacketRest decode_rest(Bytes data, std::size_t packets, const Outside& outside) {
  VarintReader reader(data, "the rest of packets");
  PacketRest rest;
  rest.layout = name(reader);
  const auto host_step = static_cast<std::int64_t>(reader.number(kMostHostStep, 1));
  const std::int64_t most_host = (kWidest - 1) / host_step;
  for (const std::int64_t steps : read_line(reader, packets)) {
    if (steps < -most_host || steps > most_host) damaged("host times of a frame's packets more than 36 years apart");
    rest.packet_ns.push_back(steps * host_step);
  }
  std::uint64_t left = kMostSeriesNumbers;
  for (std::uint64_t more = reader.number(kMostSeries); more > 0; --more) {
    Series one;
    one.name = name(reader);
    const std::uint8_t type = reader.byte();
    const bool known = std::any_of(rest.series.begin(), rest.series.end(),
                                   [&](const Series& other) { return other.name == one.name; });
    if (type > 3 || known) damaged("a series that comes twice, or of unknown type " + std::to_string(type));
    one.bytes = static_cast<std::uint8_t>(1u << type);
    const std::uint64_t count = reader.number(left);
    left -= count;
    one.values = series_values(reader, one.bytes, count, outside);
    rest.series.push_back(std::move(one));
  }
  read_odd(reader, packets, outside, rest);
  reader.end();
  return rest;
}

}  // namespace lidarcodec
