#include "session/shelf.hpp"

#include <algorithm>

#include "base/sha256.hpp"
#include "network/update.hpp"

namespace lidarcodec {

// Those of a name, which were then used last; nullptr if they are not among these.
Shelf::Weights Shelf::used(std::deque<Weights>& kept, const std::string& name) {
  const auto found =
      std::find_if(kept.begin(), kept.end(), [&](const Weights& weights) { return weights->name == name; });
  if (found == kept.end()) return nullptr;
  Weights weights = *found;
  kept.erase(found);
  kept.push_back(weights);
  return weights;
}

void Shelf::put(std::deque<Weights>& kept, Weights weights) {
  if (used(kept, weights->name) != nullptr) return;
  kept.push_back(std::move(weights));
  if (kept.size() > kKept) kept.pop_front();
}

void Shelf::take_all(const Message& message, const Outside& outside) {
  std::size_t files = 0, updates = 0;
  for (const Section& section : message.sections)
    if (section.type == static_cast<std::uint8_t>(SectionType::Weights)) ++(is_update(section.data) ? updates : files);
  if (files > 1 || updates > 1)
    throw Error(ErrorCode::Section, "a message with " + std::to_string(files + updates) +
                                        " sections of weights: one file and one update may be");
  for (const Section& section : message.sections) {
    if (section.type != static_cast<std::uint8_t>(SectionType::Weights)) continue;
    if (!is_update(section.data)) {
      put(brought_, std::make_shared<WeightFile>(read_weights(section.data)));
    } else if (used(brought_, names_of_update(section.data).to) == nullptr) {
      Weights base;
      const auto find_base = [&](const std::string& name) -> const WeightFile& {
        return *(base = find(name, message.frame_index, outside));
      };
      put(brought_, std::make_shared<WeightFile>(applied_update(section.data, find_base)));
    }
  }
}

Shelf::Weights Shelf::find(const std::string& name, std::uint64_t frame, const Outside& outside) {
  if (Weights found = used(brought_, name)) return found;
  if (Weights found = used(given_, name)) return found;
  if (const std::optional<std::vector<std::uint8_t>> data = outside.weights(name)) {
    auto weights = std::make_shared<WeightFile>(read_weights(*data));
    if (weights->name == name) {
      put(given_, weights);
      return weights;
    }
  }
  throw Error(ErrorCode::Reference,
              "weights " + name + " have not arrived yet: they come with a key frame, so ask for one", frame);
}

bool Shelf::has(const std::string& name) const {
  const auto is_it = [&](const Weights& weights) { return weights->name == name; };
  return std::any_of(brought_.begin(), brought_.end(), is_it) || std::any_of(given_.begin(), given_.end(), is_it);
}

std::string Shelf::missing(const Message& message, const std::string& name, const Outside& outside) const {
  std::vector<std::string> here, needed;
  for (const Section& section : message.sections) {
    if (section.type != static_cast<std::uint8_t>(SectionType::Weights)) continue;
    if (is_update(section.data)) {
      const UpdateNames names = names_of_update(section.data);
      if (!has(names.to)) needed.push_back(names.of);
      here.push_back(names.to);
    } else {
      here.push_back(hex(Bytes(sha256(section.data)).first(8)));
    }
  }
  needed.push_back(name);
  for (const std::string& each : needed)
    if (!has(each) && std::find(here.begin(), here.end(), each) == here.end() && !outside.weights(each)) return each;
  return "";
}

}  // namespace lidarcodec
