#include <chrono>
#include <memory>

#include "base/error.hpp"
#include "bindings.hpp"
#include "network/train.hpp"
#include "predictive/coder.hpp"
#include "riddle_layers.hpp"

using lidarcodec::Error;
using lidarcodec::ErrorCode;
using lidarcodec::RiddleNet;
using lidarcodec::RiddleNets;
using lidarcodec::RiddleSamples;
using lidarcodec::RiddleTrainer;
using lidarcodec::TrainSettings;

void bind_riddle_train(nb::module_& m) {
  nb::class_<RiddleSamples>(m, "RiddleSamples")
      .def(
          "__init__",
          [](RiddleSamples* samples, std::uint32_t share, std::uint32_t seed) {
            new (samples) RiddleSamples();
            samples->share = share;
            samples->seed = seed;
          },
          nb::arg("share"), nb::arg("seed"), "share: the number of returns that are taken, of 65536.")
      .def("__len__", &RiddleSamples::size)
      .def(
          "taken",
          [](const RiddleSamples& samples)
              -> Tuple<Array<std::int8_t>, Array<std::uint8_t>, Array<std::uint8_t>, Array<std::int16_t>> {
            const std::size_t n = samples.size();
            return nb::make_tuple(give(std::vector(samples.in), {n, samples.inputs}),
                                  give(std::vector(samples.leaf), {n}),
                                  give(std::vector(samples.offset), {n, RiddleSamples::kOffsets}),
                                  give(std::vector(samples.context_odds), {n, RiddleSamples::kDecisions}));
          },
          "Inputs (n, 72 or 112) int8, leaves (n,), first three offset bits (n, 3), 255: none, and the contexts' log "
          "odds of each "
          "decision (n, 7) int16.")
      .def_prop_ro("inputs", [](const RiddleSamples& samples) { return samples.inputs; });
  nb::class_<RiddleTrainer>(m, "RiddleTrainer")
      .def(
          "__init__",
          [](RiddleTrainer* trainer, In<std::int16_t, 2> w1, In<std::int32_t, 1> b1, std::uint32_t s1,
             In<std::int8_t, 2> c1, In<std::int16_t, 2> w2, In<std::int32_t, 1> b2, std::uint32_t s2,
             In<std::int8_t, 2> c2, In<std::int16_t, 2> w3, In<std::int32_t, 1> b3, std::uint32_t s3,
             In<std::int8_t, 2> c3, float rate, float mean, float beside, std::size_t batch, std::size_t room,
             std::size_t turns, std::size_t held_room, std::uint32_t seed) {
            const std::array<lidarcodec::GivenLayer, 3> layers = {layer_of(w1, b1, s1, c1), layer_of(w2, b2, s2, c2),
                                                                  layer_of(w3, b3, s3, c3)};
            const RiddleNet checked(layers);
            const TrainSettings settings{rate, mean, beside, batch, room, turns, held_room};
            new (trainer) RiddleTrainer(layers, settings, seed);
          },
          nb::arg("w1").noconvert(), nb::arg("b1").noconvert(), nb::arg("s1"), nb::arg("c1").noconvert(),
          nb::arg("w2").noconvert(), nb::arg("b2").noconvert(), nb::arg("s2"), nb::arg("c2").noconvert(),
          nb::arg("w3").noconvert(), nb::arg("b3").noconvert(), nb::arg("s3"), nb::arg("c3").noconvert(),
          nb::arg("rate"), nb::arg("mean"), nb::arg("beside"), nb::arg("batch"), nb::arg("room"), nb::arg("turns"),
          nb::arg("held_room"), nb::arg("seed"))
      .def(
          "add",
          [](RiddleTrainer& trainer, const RiddleSamples& samples, bool held) {
            nb::gil_scoped_release release;
            trainer.add(samples, held);
          },
          nb::arg("samples"), nb::arg("held"), "Adds samples; held: for validation, never for training.")
      .def(
          "train",
          [](RiddleTrainer& trainer, std::size_t steps, double budget_ms) {
            nb::gil_scoped_release release;
            const auto begin = std::chrono::steady_clock::now();
            return trainer.train(steps, [&] {
              return budget_ms < 0 ||
                     std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count() <
                         budget_ms;
            });
          },
          nb::arg("steps"), nb::arg("budget_ms"),
          "Takes at most `steps` steps, and begins none after `budget_ms` (negative: no limit); gives their number.")
      .def(
          "layer",
          [](const RiddleTrainer& trainer, std::size_t which) -> Tuple<Array<float>, Array<float>> {
            if (which >= lidarcodec::kNetLayers) throw Error(ErrorCode::Settings, "a network has three layers");
            const RiddleTrainer::Layer& layer = trainer.layers()[which];
            std::vector<float> weights(layer.weights.size()), bias = layer.bias;
            for (std::size_t i = 0; i < layer.in; ++i)
              for (std::size_t o = 0; o < layer.out; ++o) weights[o * layer.in + i] = layer.weights[i * layer.out + o];
            return nb::make_tuple(give(std::move(weights), {layer.out, layer.in}), give(std::move(bias), {layer.out}));
          },
          nb::arg("which"),
          "Weights (out, in) and biases (out,) of a layer, in natural units: the running mean of the steps.")
      .def(
          "conditional_bias",
          [](const RiddleTrainer& trainer) {
            const RiddleTrainer::Layer& first = trainer.layers()[0];
            return give(std::vector<float>(first.conditional_bias), {lidarcodec::kConditionalBiases, first.out});
          },
          "(96, out) biases of rows and scales of the first layer, in natural units: the running mean of the steps.")
      .def(
          "cost",
          [](const RiddleTrainer& trainer, const RiddleNets& nets, float beside) {
            const auto& net =
                nets.expecting && nets.expecting->inputs() == trainer.inputs() ? nets.expecting : nets.alone;
            if (!net) throw Error(ErrorCode::Section, "no network for such samples");
            nb::gil_scoped_release release;
            return trainer.cost(*net, beside);
          },
          nb::arg("nets"), nb::arg("beside"),
          "Mean bits of a held-out sample with a network, and the contexts weighted by `beside`.")
      .def_prop_ro("samples", &RiddleTrainer::samples)
      .def_prop_ro("held", &RiddleTrainer::held)
      .def_prop_ro("steps", &RiddleTrainer::steps);
}
