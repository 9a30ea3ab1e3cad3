#include <algorithm>

#include "base/error.hpp"
#include "bindings.hpp"
#include "packets/assembly.hpp"

namespace lc = lidarcodec;

namespace {

lc::RingOfLaser rings(const In<std::uint8_t, 1>& a) {
  if (a.shape(0) != lc::kRings) throw lc::Error(lc::ErrorCode::Settings, "ring_of_laser must have 64 entries");
  lc::RingOfLaser out;
  std::copy_n(a.data(), lc::kRings, out.begin());
  return out;
}

void expect(bool fits, const char* what) {
  if (!fits) throw lc::Error(lc::ErrorCode::Section, what);
}

}  // namespace

void bind_assembly(nb::module_& m) {
  m.def(
      "assemble",
      [](nb::bytes payloads, In<std::uint8_t, 1> ring_of_laser)
          -> Tuple<Array<std::uint16_t>, Array<std::uint8_t>, Array<std::uint16_t>, Array<std::uint8_t>,
                   Array<std::uint8_t>, Array<std::uint16_t>, Array<std::uint8_t>, Array<std::uint8_t>,
                   Array<std::uint32_t>, Array<std::uint8_t>> {
        const lc::RingOfLaser ring = rings(ring_of_laser);
        const std::uint8_t* data = data_of(payloads);
        const std::size_t size = payloads.size();
        lc::Assembled a;
        {
          nb::gil_scoped_release release;
          a = lc::assemble(data, size, ring);
        }
        const std::size_t w = a.width, p = a.layout.size();
        const std::size_t layouts = a.layouts.size() / lc::kBlocks, irregular = a.irregular.size() / lc::kBlockBytes,
                          second = a.second.size() / lc::kBlockReturnBytes;
        return nb::make_tuple(give(std::move(a.range), {lc::kRings, w}), give(std::move(a.intensity), {lc::kRings, w}),
                              give(std::move(a.azimuth), {2, w}), give(std::move(a.fired), {2, w}),
                              give(std::move(a.layouts), {layouts, lc::kBlocks}), give(std::move(a.layout), {p}),
                              give(std::move(a.irregular), {irregular, lc::kBlockBytes}),
                              give(std::move(a.second), {second, lc::kBlockReturnBytes}),
                              give(std::move(a.gps_us), {p}), give(std::move(a.status), {p, 2}));
      },
      nb::arg("payloads"), nb::arg("ring_of_laser").noconvert(),
      "Images and side information of whole packets: range, intensity, azimuth, fired, layouts, layout, irregular, "
      "second, gps_us, status.");

  m.def(
      "disassemble",
      [](In<std::uint16_t, 2> range, In<std::uint8_t, 2> intensity, In<std::uint16_t, 2> azimuth,
         In<std::uint8_t, 2> fired, In<std::uint8_t, 2> layouts, In<std::uint16_t, 1> layout,
         In<std::uint8_t, 2> irregular, In<std::uint8_t, 2> second, In<std::uint32_t, 1> gps_us,
         In<std::uint8_t, 2> status, In<std::uint8_t, 1> ring_of_laser) {
        const lc::RingOfLaser ring = rings(ring_of_laser);
        const std::size_t w = range.shape(1), p = layout.shape(0);
        expect(range.shape(0) == lc::kRings && intensity.shape(0) == lc::kRings && intensity.shape(1) == w,
               "range and intensity images must both be 64 x W");
        expect(azimuth.shape(0) == 2 && azimuth.shape(1) == w && fired.shape(0) == 2 && fired.shape(1) == w,
               "azimuth and fired must be 2 x W");
        expect(layouts.shape(1) == lc::kBlocks && irregular.shape(1) == lc::kBlockBytes &&
                   second.shape(1) == lc::kBlockReturnBytes,
               "layouts, irregular or second blocks have the wrong length");
        expect(gps_us.shape(0) == p && status.shape(0) == p && status.shape(1) == 2,
               "time stamps and status bytes must be one a packet");
        const lc::Images in{w,
                            range.data(),
                            intensity.data(),
                            azimuth.data(),
                            fired.data(),
                            p,
                            layouts.shape(0),
                            layouts.data(),
                            layout.data(),
                            irregular.shape(0),
                            irregular.data(),
                            second.shape(0),
                            second.data(),
                            gps_us.data(),
                            status.data()};
        std::vector<std::uint8_t> out;
        {
          nb::gil_scoped_release release;
          out = lc::disassemble(in, ring);
        }
        return give_bytes(out);
      },
      nb::arg("range").noconvert(), nb::arg("intensity").noconvert(), nb::arg("azimuth").noconvert(),
      nb::arg("fired").noconvert(), nb::arg("layouts").noconvert(), nb::arg("layout").noconvert(),
      nb::arg("irregular").noconvert(), nb::arg("second").noconvert(), nb::arg("gps_us").noconvert(),
      nb::arg("status").noconvert(), nb::arg("ring_of_laser").noconvert(), "Payloads, one after the other, as bytes.");
}
