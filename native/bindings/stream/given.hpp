// What Python gives the decoder of a stream: native/src/session/outside.hpp.
#pragma once
#include <algorithm>
#include <optional>
#include <string>

#include "bindings.hpp"
#include "session/outside.hpp"

using Unzstd = nb::typed<nb::callable, nb::bytes(nb::bytes, nb::int_)>;
using Inflate = nb::typed<nb::callable, std::optional<nb::bytes>(nb::bytes, nb::int_)>;
using TakesModel = nb::typed<nb::callable, bool(nb::str)>;
using FindWeights = nb::typed<nb::callable, std::optional<nb::bytes>(nb::str)>;

inline lidarcodec::Bytes bytes_of(const nb::bytes& data) { return {data_of(data), data.size()}; }

// The decoder runs without the interpreter's lock, each call takes it.
class GivenUnzstd : public lidarcodec::Outside {
 public:
  explicit GivenUnzstd(Unzstd unzstd) : unzstd_(std::move(unzstd)) {}

  bool unzstd(lidarcodec::Bytes frame, std::span<std::uint8_t> plain) const override {
    nb::gil_scoped_acquire lock;
    const auto found = nb::cast<nb::bytes>(unzstd_(nb::bytes(frame.data(), frame.size()), plain.size()));
    if (found.size() != plain.size()) return false;
    std::copy_n(data_of(found), plain.size(), plain.begin());
    return true;
  }

  std::optional<std::vector<std::uint8_t>> inflated(lidarcodec::Bytes, std::size_t) const override {
    return std::nullopt;
  }

  // The package reads it: lidarcodec/planes/clouds.
  std::shared_ptr<const lidarcodec::DecodedCloud> cloud(lidarcodec::Bytes) const override { return nullptr; }

 private:
  Unzstd unzstd_;
};

class Given final : public GivenUnzstd {
 public:
  Given(Unzstd unzstd, Inflate inflate, FindWeights weights, bool reads_ranges, std::optional<TakesModel> takes_model)
      : GivenUnzstd(std::move(unzstd)),
        inflate_(std::move(inflate)),
        weights_(std::move(weights)),
        reads_ranges_(reads_ranges),
        takes_model_(std::move(takes_model)) {}

  std::optional<std::vector<std::uint8_t>> inflated(lidarcodec::Bytes stream, std::size_t most) const override {
    nb::gil_scoped_acquire lock;
    return vector_of(inflate_(nb::bytes(stream.data(), stream.size()), most));
  }

  bool reads_ranges(lidarcodec::Codec, bool planes) const override { return reads_ranges_ && !planes; }

  bool takes_model(const std::string& name) const override {
    if (!takes_model_) return false;
    nb::gil_scoped_acquire lock;
    return nb::cast<bool>((*takes_model_)(name));
  }

  std::optional<std::vector<std::uint8_t>> weights(const std::string& name) const override {
    nb::gil_scoped_acquire lock;
    return vector_of(weights_(name));
  }

 private:
  static std::optional<std::vector<std::uint8_t>> vector_of(const nb::object& found) {
    if (found.is_none()) return std::nullopt;
    const lidarcodec::Bytes data = bytes_of(nb::cast<nb::bytes>(found));
    return std::vector<std::uint8_t>(data.begin(), data.end());
  }

  Inflate inflate_;
  FindWeights weights_;
  bool reads_ranges_;
  std::optional<TakesModel> takes_model_;
};
