#include "base/crc32c.hpp"
#include "bindings.hpp"

void bind_crc32c(nb::module_& m) {
  m.def(
      "crc32c",
      [](nb::bytes data, std::uint32_t seed) {
        const std::uint8_t* bytes = data_of(data);
        const std::size_t size = data.size();
        nb::gil_scoped_release release;
        return lidarcodec::crc32c(bytes, size, seed);
      },
      nb::arg("data"), nb::arg("seed") = 0, "CRC-32C of `data`, going on from `seed`.");
}
