#include <memory>
#include <string>

#include "base/error.hpp"
#include "bindings.hpp"
#include "geometry.hpp"
#include "predictive/coder.hpp"
#include "range_images.hpp"
#include "riddle_layers.hpp"

namespace {

using lidarcodec::Error;
using lidarcodec::ErrorCode;
using lidarcodec::NetForm;
using lidarcodec::NetValues;
using lidarcodec::RiddleNet;
using lidarcodec::RiddleNets;

}  // namespace

void bind_riddle(nb::module_& m) {
  m.def(
      "net_forms",
      []() -> List<nb::str> {
        nb::list names;
        for (const NetForm form : lidarcodec::net_forms_here()) names.append(lidarcodec::name_of(form));
        return names;
      },
      "The forms of networks that this processor can run, the fastest last.");
  nb::class_<RiddleNets>(m, "RiddleNets")
      .def(nb::init<>())
      .def(
          "set",
          [](RiddleNets& nets, In<std::int16_t, 2> w1, In<std::int32_t, 1> b1, std::uint32_t s1, In<std::int8_t, 2> c1,
             In<std::int16_t, 2> w2, In<std::int32_t, 1> b2, std::uint32_t s2, In<std::int8_t, 2> c2,
             In<std::int16_t, 2> w3, In<std::int32_t, 1> b3, std::uint32_t s3, In<std::int8_t, 2> c3,
             const char* form) {
            RiddleNet net({layer_of(w1, b1, s1, c1), layer_of(w2, b2, s2, c2), layer_of(w3, b3, s3, c3)},
                          lidarcodec::net_form_named(form));
            (net.inputs() == lidarcodec::kInputsExpecting ? nets.expecting : nets.alone).emplace(std::move(net));
          },
          nb::arg("w1").noconvert(), nb::arg("b1").noconvert(), nb::arg("s1"), nb::arg("c1").noconvert(),
          nb::arg("w2").noconvert(), nb::arg("b2").noconvert(), nb::arg("s2"), nb::arg("c2").noconvert(),
          nb::arg("w3").noconvert(), nb::arg("b3").noconvert(), nb::arg("s3"), nb::arg("c3").noconvert(),
          nb::arg("form") = "",
          "Sets a network. Its number of inputs tells whether it is for frames with expected ranges.")
      .def(
          "run",
          [](const RiddleNets& nets, In<std::int8_t, 2> inputs) {
            const auto& net = inputs.shape(1) == lidarcodec::kInputsExpecting ? nets.expecting : nets.alone;
            if (!net || net->inputs() != inputs.shape(1)) throw Error(ErrorCode::Section, "no network for such inputs");
            std::vector<std::int16_t> odds(inputs.shape(0) * lidarcodec::kNetOutputs);
            const std::size_t count = inputs.shape(0), width = inputs.shape(1);
            NetValues values[4];
            const auto run = [&]<std::size_t N>(std::size_t first, const std::array<NetValues*, N>& at) {
              for (std::size_t k = 0; k < N; ++k)
                std::copy_n(inputs.data() + (first + k) * width, width, at[k]->in.begin());
              net->run(at);
              for (std::size_t k = 0; k < N; ++k) {
                std::int16_t* const of = std::copy(at[k]->out.begin(), at[k]->out.end(),
                                                   odds.data() + (first + k) * lidarcodec::kNetOutputs);
                for (std::size_t leaf = 0; leaf < lidarcodec::kLeafOdds; ++leaf)
                  of[leaf] = net->leaf_odds(*at[k], leaf);
              }
            };
            std::size_t i = 0;  // four at a time as in frames, two as in slabs, one as at the ends of rows
            for (; i + 4 <= count; i += 4) run(i, std::array{values, values + 1, values + 2, values + 3});
            for (; i + 2 <= count; i += 2) run(i, std::array{values, values + 1});
            for (; i < count; ++i) run(i, std::array{values});
            return give(std::move(odds), {inputs.shape(0), lidarcodec::kNetOutputs});
          },
          nb::arg("inputs").noconvert(), "(n, 32) int16 log odds of (n, 72 or 112) inputs.");
  m.def(
      "riddle_samples",
      [](In<std::uint16_t, 2> ranges, In<std::uint8_t, 2> returns, std::uint32_t step, In<std::int32_t, 1> level,
         In<std::uint8_t, 2> fired, In<std::uint8_t, 1> half, In<std::int32_t, 1> rotation, std::uint32_t turn,
         In<std::uint16_t, 2> expected, std::uint32_t share,
         std::uint32_t seed) -> Tuple<Array<std::int8_t>, Array<std::uint8_t>, Array<std::uint8_t>> {
        const lidarcodec::MaskGeometry geometry = geometry_of(fired, half, rotation);
        expect_image(ranges, geometry);
        expect_image(returns, geometry);
        const lidarcodec::RangeCells cells = cells_of(step, level);
        const std::uint16_t* const seen = expectation(expected, geometry);
        lidarcodec::RiddleSamples samples;
        samples.share = share;
        samples.seed = seed;
        {
          nb::gil_scoped_release release;
          lidarcodec::PredictiveCoder::sample(ranges.data(), returns.data(), cells, geometry, turn, seen, samples);
        }
        const std::size_t n = samples.leaf.size();
        return nb::make_tuple(give(std::move(samples.in), {n, samples.inputs}), give(std::move(samples.leaf), {n}),
                              give(std::move(samples.offset), {n, lidarcodec::RiddleSamples::kOffsets}));
      },
      nb::arg("ranges").noconvert(), nb::arg("returns").noconvert(), nb::arg("step"), nb::arg("level").noconvert(),
      nb::arg("fired").noconvert(), nb::arg("half").noconvert(), nb::arg("rotation").noconvert(), nb::arg("turn"),
      nb::arg("expected").noconvert(), nb::arg("share"), nb::arg("seed"),
      "Samples of `share` of 65536 returns: inputs (n, 72 or 112) int8, leaves (n,), and the first three offset bits "
      "(n, 3), "
      "255: none.");
}
