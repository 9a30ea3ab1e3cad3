#include "network/weight_file.hpp"

#include <algorithm>
#include <cstdlib>
#include <utility>

#include "base/crc32c.hpp"
#include "base/sha256.hpp"

namespace lidarcodec {
namespace {

constexpr std::array<std::uint8_t, 4> kMagic = {'L', 'C', 'R', 'W'};
constexpr std::uint64_t kVersion = 1;
constexpr std::size_t kMostProvenance = 1u << 16, kChecksumBytes = 4, kNameBytes = 8;
constexpr std::uint8_t kSizes = 3;
constexpr std::uint32_t kInBytes = 128, kWithCases = 64, kFewTiles = 32;  // added to the shift of a layer
constexpr std::size_t kTileBytes = kTileOutputs * kTileInputs;

[[noreturn]] void damaged(const char* what, std::size_t at = 0) { throw Error(ErrorCode::Section, what, at); }

std::int16_t weight_at(Bytes data, std::size_t i, bool in_bytes) {
  return in_bytes ? static_cast<std::int8_t>(data[i]) : static_cast<std::int16_t>(little_endian(data, 2 * i, 2));
}

std::size_t blocks_of(const NetworkLayer& layer) { return (layer.out + kTileOutputs - 1) / kTileOutputs; }

// Weights of a layer of which some tiles are there: which they are, a bit each, and their weights.
void read_tiles(ByteReader& reader, bool in_bytes, NetworkLayer& layer) {
  const std::size_t blocks = blocks_of(layer), across = layer.in / kTileInputs, tiles = blocks * across;
  const Bytes left = reader.take((tiles + 7) / 8);
  const auto is_left = [&](std::size_t tile) { return (left[tile / 8] >> (tile % 8) & 1) != 0; };
  std::size_t count = 0;
  for (std::size_t tile = 0; tile < tiles; ++tile) count += is_left(tile);
  for (std::size_t bit = tiles; bit < 8 * left.size(); ++bit)
    if (is_left(bit)) damaged("a layer whose tiles are not those that have weights", reader.at());
  const Bytes kept = reader.take(count * kTileBytes * (in_bytes ? 1 : 2));
  std::size_t from = 0;
  for (std::size_t tile = 0; tile < tiles; ++tile) {
    if (!is_left(tile)) continue;
    const std::size_t block = tile / across, in = tile % across * kTileInputs;
    bool empty = true;
    for (std::size_t i = 0; i < kTileBytes; ++i, ++from) {
      const std::int16_t weight = weight_at(kept, from, in_bytes);
      const std::size_t out = block * kTileOutputs + i / kTileInputs;
      empty = empty && weight == 0;
      if (out < layer.out) layer.weights[out * layer.in + in + i % kTileInputs] = weight;
      if (out >= layer.out && weight != 0) damaged("a layer with weights of sums that it does not have", reader.at());
    }
    if (empty) damaged("a layer whose tiles are not those that have weights", reader.at());
  }
  if (count == tiles) damaged("a layer whose tiles are not those that have weights", reader.at());
}

Network read_network(ByteReader& reader) {
  Network network;
  const Bytes kind = reader.take(3);
  if (kind[0] > 1 || kind[1] >= kSizes || kind[2] != kNetLayers)
    damaged("a network of an unknown kind, size or number of layers", reader.at());
  network.expects = kind[0] != 0;
  network.size = kind[1];
  std::array<std::size_t, kNetLayers + 1> dims;
  for (std::size_t& dim : dims) dim = reader.number(2);
  const auto hidden = [](std::size_t n) { return n >= 8 && n <= kMaxHidden && n % 8 == 0; };
  if (dims[0] != (network.expects ? kInputsExpecting : kInputsAlone) || !hidden(dims[1]) || !hidden(dims[2]) ||
      dims[3] != kNetOutputs)
    damaged("a network with layers of other sizes than are possible", reader.at());
  const Bytes shifts = reader.take(kNetLayers);
  for (std::size_t l = 0; l < kNetLayers; ++l) {
    NetworkLayer& layer = network.layers[l];
    layer.in = dims[l];
    layer.out = dims[l + 1];
    const bool in_bytes = (shifts[l] & kInBytes) != 0, with_cases = (shifts[l] & kWithCases) != 0;
    const bool few = (shifts[l] & kFewTiles) != 0;
    layer.shift = shifts[l] & ~(kInBytes | kWithCases | kFewTiles);
    layer.weights.resize(layer.in * layer.out);
    if (few) {
      read_tiles(reader, in_bytes, layer);
    } else {
      const Bytes kept = reader.take(layer.weights.size() * (in_bytes ? 1 : 2));
      for (std::size_t i = 0; i < layer.weights.size(); ++i) layer.weights[i] = weight_at(kept, i, in_bytes);
    }
    layer.bias.resize(layer.out);
    for (std::int32_t& bias : layer.bias) bias = static_cast<std::int32_t>(reader.number(4));
    if (with_cases) {
      const Bytes kept = reader.take(kConditionalBiases * layer.out);
      layer.conditional_bias.assign(kept.begin(), kept.end());
    }
    if (layer.in_bytes() != in_bytes) damaged("a layer that fits bytes and is not kept in them", reader.at());
    if (layer.has_pruned_tiles() != few) damaged("a layer with empty tiles that are not left out", reader.at());
  }
  check_layers(network.given());
  return network;
}

bool has_two_alike(const std::vector<Network>& networks) {
  for (std::size_t i = 0; i < networks.size(); ++i)
    for (std::size_t j = 0; j < i; ++j)
      if (networks[i].expects == networks[j].expects && networks[i].size == networks[j].size) return true;
  return false;
}

struct Writer {
  void put(std::uint64_t value, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) bytes.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  }
  void put_weight(std::int16_t weight, bool in_bytes) { put(static_cast<std::uint16_t>(weight), in_bytes ? 1 : 2); }

  std::vector<std::uint8_t> bytes;
};

void write_tiles(const NetworkLayer& layer, bool in_bytes, Writer& to) {
  const std::size_t blocks = blocks_of(layer), across = layer.in / kTileInputs;
  const GivenLayer given = layer.given();
  std::vector<std::uint8_t> left((blocks * across + 7) / 8);
  for (std::size_t tile = 0; tile < blocks * across; ++tile)
    if (!is_pruned(given, tile / across, tile % across * kTileInputs))
      left[tile / 8] |= static_cast<std::uint8_t>(1u << (tile % 8));
  to.bytes.insert(to.bytes.end(), left.begin(), left.end());
  for (std::size_t tile = 0; tile < blocks * across; ++tile) {
    if ((left[tile / 8] >> (tile % 8) & 1) == 0) continue;
    for (std::size_t i = 0; i < kTileBytes; ++i) {
      const std::size_t out = tile / across * kTileOutputs + i / kTileInputs,
                        in = tile % across * kTileInputs + i % kTileInputs;
      to.put_weight(out < layer.out ? layer.weights[out * layer.in + in] : std::int16_t{0}, in_bytes);
    }
  }
}

}  // namespace

bool NetworkLayer::in_bytes() const {
  return std::all_of(weights.begin(), weights.end(), [](std::int16_t w) { return w >= -128 && w <= 127; });
}

bool NetworkLayer::has_pruned_tiles() const {
  const GivenLayer layer = given();
  for (std::size_t block = 0; block < blocks_of(*this); ++block)
    for (std::size_t i = 0; i < in; i += kTileInputs)
      if (is_pruned(layer, block, i)) return true;
  return false;
}

const Network& WeightFile::network(bool expects, std::uint8_t size) const {
  const Network* best = nullptr;
  const auto order = [&](const Network& n) { return std::pair(std::abs(n.size - size), n.size); };
  for (const Network& network : networks)
    if (network.expects == expects && (best == nullptr || order(network) < order(*best))) best = &network;
  if (best == nullptr) damaged("weights without a network for frames of this kind");
  return *best;
}

WeightFile read_weights(Bytes data) {
  if (data.size() > kMostWeightBytes) damaged("weights of too many bytes");
  if (data.size() < kMagic.size() || !std::equal(kMagic.begin(), kMagic.end(), data.begin()))
    throw Error(ErrorCode::Header, "not a weight file");
  const std::size_t body = data.size() < kMagic.size() + kChecksumBytes ? 0 : data.size() - kChecksumBytes;
  ByteReader reader(data.first(body), "weights");
  reader.take(kMagic.size());
  const std::uint64_t version = reader.number(1);
  if (version != kVersion)
    throw Error(ErrorCode::Version, "weights of version " + std::to_string(version) + ": this build reads version 1",
                kMagic.size());
  if (crc32c(data.data(), body) != little_endian(data, body, kChecksumBytes))
    throw Error(ErrorCode::Checksum, "the checksum of the weights does not match", body);
  const std::size_t provenance = reader.number(4);
  if (provenance > kMostProvenance) damaged("a provenance of too many bytes", reader.at());
  reader.take(provenance);
  const std::size_t count = reader.number(1);
  if (count < 1 || count > kMostNetworks) damaged("weights of no networks, or of too many", reader.at());
  WeightFile file;
  for (std::size_t i = 0; i < count; ++i) file.networks.push_back(read_network(reader));
  if (has_two_alike(file.networks)) damaged("weights with two networks of one kind and size", reader.at());
  if (reader.left() != 0) damaged("weights with bytes left over", reader.at());
  file.name = hex(Bytes(sha256(data)).first(kNameBytes));
  return file;
}

std::vector<std::uint8_t> write_weights(const std::vector<Network>& networks) {
  Writer to;
  to.bytes.assign(kMagic.begin(), kMagic.end());
  to.put(kVersion, 1);
  to.put(2, 4);
  to.put('{', 1);
  to.put('}', 1);
  to.put(networks.size(), 1);
  for (const Network& network : networks) {
    to.put(network.expects, 1);
    to.put(network.size, 1);
    to.put(kNetLayers, 1);
    to.put(network.layers[0].in, 2);
    for (const NetworkLayer& layer : network.layers) to.put(layer.out, 2);
    for (const NetworkLayer& layer : network.layers)
      to.put(layer.shift + (layer.in_bytes() ? kInBytes : 0) + (layer.conditional_bias.empty() ? 0 : kWithCases) +
                 (layer.has_pruned_tiles() ? kFewTiles : 0),
             1);
    for (const NetworkLayer& layer : network.layers) {
      const bool in_bytes = layer.in_bytes();
      if (layer.has_pruned_tiles()) {
        write_tiles(layer, in_bytes, to);
      } else {
        for (const std::int16_t weight : layer.weights) to.put_weight(weight, in_bytes);
      }
      for (const std::int32_t bias : layer.bias) to.put(static_cast<std::uint32_t>(bias), 4);
      to.bytes.insert(to.bytes.end(), layer.conditional_bias.begin(), layer.conditional_bias.end());
    }
  }
  to.put(crc32c(to.bytes.data(), to.bytes.size()), kChecksumBytes);
  return std::move(to.bytes);
}

}  // namespace lidarcodec
