#include "network/update.hpp"

#include <algorithm>
#include <limits>

#include "base/crc32c.hpp"
#include "base/sha256.hpp"
#include "bits/numbers.hpp"

namespace lidarcodec {
namespace {

constexpr std::array<std::uint8_t, 4> kMagic = {'L', 'C', 'R', 'U'};
constexpr std::uint64_t kVersion = 1;
constexpr std::size_t kNameBytes = 8, kChecksumBytes = 4;
constexpr std::size_t kNetworkBytes = 6;  // kind, size, and the grains of three layers and of biases of cases
constexpr std::uint8_t kMostGrain = 12, kSizes = 3;
constexpr std::array<std::uint8_t, kNetLayers> kBiasBits = {
    5, 3, 3};  // of how many bits a step of a bias is smaller than one of a weight

struct Changed {
  Network network;
  std::array<std::uint8_t, kNetLayers + 1> grains{};
};

[[noreturn]] void damaged(const char* what) { throw Error(ErrorCode::Section, what); }

Bytes body_of(Bytes data) { return data.first(data.size() < kChecksumBytes ? 0 : data.size() - kChecksumBytes); }

const Network& network_of(const WeightFile& file, bool expects, std::uint8_t size) {
  for (const Network& network : file.networks)
    if (network.expects == expects && network.size == size) return network;
  damaged("an update of a network that its weights do not have");
}

// Adds steps to numbers, each of 2^grain. Raises Section where a sum is beyond `most` on either side.
template <class Number>
const std::uint64_t* add_steps(std::vector<Number>& numbers, const std::uint64_t* folded, unsigned grain,
                               std::int64_t most) {
  for (Number& number : numbers) {
    const std::uint64_t n = *folded++;
    if (n >> 32 != 0) damaged("an update of a weight beyond what it can be");
    const auto half = static_cast<std::int64_t>(n >> 1);
    const std::int64_t moved = number + (n % 2 != 0 ? -half - 1 : half) * (std::int64_t{1} << grain);
    if (moved > most || moved < -most) damaged("an update of a weight beyond what it can be");
    number = static_cast<Number>(moved);
  }
  return folded;
}

}  // namespace

bool is_update(Bytes data) {
  return data.size() >= kMagic.size() && std::equal(kMagic.begin(), kMagic.end(), data.begin());
}

UpdateNames names_of_update(Bytes data) {
  ByteReader reader(body_of(data), "weights");
  reader.take(kMagic.size());
  const std::uint64_t version = reader.number(1);
  if (version != kVersion)
    throw Error(ErrorCode::Version,
                "an update of weights of version " + std::to_string(version) + ": this build reads version 1",
                kMagic.size());
  const std::string of = hex(reader.take(kNameBytes)), to = hex(reader.take(kNameBytes));
  const std::size_t body = body_of(data).size();
  if (crc32c(data.data(), body) != little_endian(data, body, kChecksumBytes))
    throw Error(ErrorCode::Checksum, "the checksum of an update of weights does not match", body);
  return {of, to};
}

WeightFile applied_update(Bytes data, const std::function<const WeightFile&(const std::string&)>& find) {
  const UpdateNames names = names_of_update(data);
  const WeightFile& base = find(names.of);
  ByteReader reader(body_of(data), "weights");
  reader.take(kMagic.size() + 1 + 2 * kNameBytes);
  std::vector<Changed> changed(reader.number(1));
  if (changed.empty() || changed.size() > base.networks.size()) damaged("an update of no networks, or of too many");
  std::vector<std::size_t> counts;
  for (Changed& change : changed) {
    const Bytes head = reader.take(kNetworkBytes);
    std::copy(head.begin() + 2, head.end(), change.grains.begin());
    if (head[0] > 1 || head[1] >= kSizes || *std::max_element(change.grains.begin(), change.grains.end()) > kMostGrain)
      damaged("an update of a network of an unknown kind, size or grain");
    change.network = network_of(base, head[0] != 0, head[1]);
  }
  for (std::size_t i = 0; i < changed.size(); ++i)
    for (std::size_t j = 0; j < i; ++j)
      if (changed[i].network.expects == changed[j].network.expects &&
          changed[i].network.size == changed[j].network.size)
        damaged("an update with two networks of one kind and size");
  for (Changed& change : changed) {
    for (const NetworkLayer& layer : change.network.layers) {
      counts.push_back(layer.weights.size());
      counts.push_back(layer.bias.size());
    }
    NetworkLayer& first = change.network.layers[0];
    first.conditional_bias.resize(kConditionalBiases * first.out);  // zeros where there were none
    counts.push_back(first.conditional_bias.size());
  }
  const Bytes coded = reader.take(reader.left());
  const std::vector<std::uint64_t> steps = decode_numbers(coded.data(), coded.size(), counts);
  const std::uint64_t* from = steps.data();
  std::vector<Network> given;
  for (Changed& change : changed) {
    for (std::size_t l = 0; l < kNetLayers; ++l) {
      NetworkLayer& layer = change.network.layers[l];
      from = add_steps(layer.weights, from, change.grains[l], std::numeric_limits<std::int16_t>::max());
      from = add_steps(layer.bias, from, change.grains[l] + kBiasBits[l], std::numeric_limits<std::int32_t>::max());
    }
    from = add_steps(change.network.layers[0].conditional_bias, from, change.grains[kNetLayers],
                     std::numeric_limits<std::int8_t>::max());
    check_layers(change.network.given());
    given.push_back(std::move(change.network));
  }
  const std::string name = hex(Bytes(sha256(write_weights(given))).first(kNameBytes));
  if (name != names.to) damaged("an update that gives other weights than it says");
  return {name, std::move(given)};
}

}  // namespace lidarcodec
