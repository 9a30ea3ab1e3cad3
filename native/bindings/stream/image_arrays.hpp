// What the decoder finds in a frame of another sensor than an HDL-64E, as Python gets it.
#pragma once
#include <nanobind/stl/string.h>

#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "bindings.hpp"
#include "session/frames/plane_section.hpp"
#include "session/frames/rest.hpp"

// Read-only, so that a frame takes them as they are.
template <typename T>
using Fixed = nb::ndarray<nb::numpy, const T>;
using Unsigned = nb::ndarray<nb::numpy, nb::ro>;  // of any type without sign
using NamedNumbers = List<Tuple<nb::str, Unsigned>>;
using Rest = Tuple<nb::str, Fixed<std::int64_t>, Fixed<std::uint16_t>, List<nb::bytes>, NamedNumbers>;

// Unsigned numbers in the narrowest type, made without the interpreter's lock.
using Narrow = std::variant<std::vector<std::uint8_t>, std::vector<std::uint16_t>, std::vector<std::uint32_t>,
                            std::vector<std::uint64_t>>;

template <typename T>
Narrow narrowed(std::vector<T>&& values, std::size_t bytes) {
  if (bytes == sizeof(T)) return std::move(values);
  if (bytes == 1) return std::vector<std::uint8_t>(values.begin(), values.end());
  if (bytes == 2) return std::vector<std::uint16_t>(values.begin(), values.end());
  if (bytes == 4) return std::vector<std::uint32_t>(values.begin(), values.end());
  return std::vector<std::uint64_t>(values.begin(), values.end());
}

// Frees the numbers of planes on the way, so that memory does not hold both forms of all of them.
inline std::vector<std::pair<std::string, Narrow>> narrow_planes(std::vector<lidarcodec::NamedPlane>&& planes) {
  std::vector<std::pair<std::string, Narrow>> found;
  for (lidarcodec::NamedPlane& plane : planes) {
    lidarcodec::PlaneImage values = std::move(plane.values);
    found.emplace_back(plane.name, narrowed(std::move(values), lidarcodec::plane_bytes(plane.bits)));
  }
  return found;
}

struct NarrowRest {
  lidarcodec::PacketRest rest;
  std::vector<std::pair<std::string, Narrow>> series;
};

inline NarrowRest narrow_rest(lidarcodec::PacketRest&& rest) {
  NarrowRest found;
  for (lidarcodec::Series& one : rest.series)
    found.series.emplace_back(one.name, narrowed(std::move(one.values), one.bytes));
  rest.series.clear();
  found.rest = std::move(rest);
  return found;
}

template <typename T>
Fixed<T> give_fixed(std::vector<T>&& values, std::initializer_list<std::size_t> shape) {
  auto* owned = new std::vector<T>(std::move(values));
  nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return Fixed<T>(owned->data(), shape, owner);
}

// rows: of planes, (rows, N); 0: of series, (N,)
inline NamedNumbers give_named(std::vector<std::pair<std::string, Narrow>>&& named, std::size_t rows = 0) {
  nb::list found;
  for (auto& [name, numbers] : named)
    std::visit(
        [&](auto& values) {
          const std::size_t count = values.size();
          found.append(nb::make_tuple(name, rows == 0 ? give_fixed(std::move(values), {count})
                                                      : give_fixed(std::move(values), {rows, count / rows})));
        },
        numbers);
  return NamedNumbers(found);
}

inline Rest give_rest(NarrowRest&& given) {
  lidarcodec::PacketRest& rest = given.rest;
  nb::list odd_packets;
  for (const std::vector<std::uint8_t>& packet : rest.odd_packets) odd_packets.append(give_bytes(packet));
  const std::size_t packets = rest.packet_ns.size(), odd = rest.odd.size();
  return Rest(nb::make_tuple(rest.layout, give_fixed(std::move(rest.packet_ns), {packets}),
                             give_fixed(std::move(rest.odd), {odd}), odd_packets, give_named(std::move(given.series))));
}
