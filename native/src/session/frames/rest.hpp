// The REST section (docs/wire-format-other-sensors.md): what packets of another sensor than an HDL-64E hold beside the
// planes of a frame; lidarcodec/entropy/rest_coder.py writes it.
#pragma once
#include "base/varint.hpp"
#include "sensors/model.hpp"
#include "session/outside.hpp"

namespace lidarcodec {

struct PacketRest {
  std::string layout;                   // of the packets that are not odd; "" if all are
  std::vector<std::int64_t> packet_ns;  // host time of each packet, less the frame's stamp
  std::vector<Series> series;           // of the packets that are not odd
  std::vector<std::uint16_t> odd;       // places of packets that have no place in images, ascending
  std::vector<std::vector<std::uint8_t>> odd_packets;

  // Places of the packets that are not odd.
  std::vector<std::size_t> regular() const;
};

// Series of signed numbers in one range coded stream, one behind the other. Raises Section or Truncated.
std::vector<std::int64_t> signed_numbers(Bytes data, const std::vector<std::size_t>& counts);

// A line of so many numbers, modulo 2^64. Raises Section or Truncated.
std::vector<std::int64_t> read_line(VarintReader& reader, std::size_t count);

// The rest of so many packets. Raises Section or Truncated, before it takes more memory than a frame may have.
PacketRest decode_rest(Bytes data, std::size_t packets, const Outside& outside);

}  // namespace lidarcodec
