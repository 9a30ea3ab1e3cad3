// Decodes files of messages as the plug-in does: whole, with one lost, and damaged.
//   test_decoder FILE...             for ctest: exit code 1 if anything is wrong
//   test_decoder --points FILE OUT   writes the points of each message into the folder OUT, for the test in Python
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>

#include "decoder.hpp"

using lidarcodec_point_cloud_transport::Cloud;
using lidarcodec_point_cloud_transport::Decoder;
using lidarcodec_point_cloud_transport::Outcome;

namespace {

using Message = std::vector<uint8_t>;

int failures = 0;

void expect(bool holds, const std::string& what) {
  if (holds) return;
  std::cerr << "failed: " << what << "\n";
  ++failures;
}

uint32_t number(const Message& bytes, size_t at) {
  return bytes[at] | uint32_t{bytes[at + 1]} << 8 | uint32_t{bytes[at + 2]} << 16 | uint32_t{bytes[at + 3]} << 24;
}

std::vector<Message> messages_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const Message all((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  std::vector<Message> found;
  for (size_t at = 0; at + 12 <= all.size(); at += number(all, at + 8))
    found.emplace_back(all.begin() + static_cast<std::ptrdiff_t>(at),
                       all.begin() + static_cast<std::ptrdiff_t>(at + number(all, at + 8)));
  return found;
}

bool is_key(const Message& message) { return (message[14] & 1) != 0; }

void test(const std::string& path) {
  const std::vector<Message> messages = messages_of(path);
  expect(!messages.empty(), path + " has messages");
  Cloud cloud;
  Decoder whole;
  for (const Message& message : messages) {
    const Outcome outcome = whole.decode(message.data(), message.size(), cloud);
    expect(outcome == Outcome::Decoded, path + ": " + whole.why());
    expect(cloud.data.size() == size_t{cloud.points} * cloud.point_step, path + ": the size of the points");
  }
  Decoder late;  // comes in the middle: it waits for a key message, and shows nothing before
  bool begun = false;
  for (size_t i = 1; i < messages.size(); ++i) {
    begun = begun || is_key(messages[i]);
    Cloud untouched;
    const Outcome outcome = late.decode(messages[i].data(), messages[i].size(), untouched);
    expect(outcome == (begun ? Outcome::Decoded : Outcome::Waiting), path + ": the outcome after a lost message");
    expect(begun || untouched.data.empty(), path + ": no points while it waits");
  }
  Decoder hostile;
  for (const Message& message : messages)
    for (size_t cut = 0; cut < message.size(); cut += message.size() / 7 + 1) {
      Message damaged = message;
      damaged[cut] ^= 0x5a;
      expect(hostile.decode(damaged.data(), damaged.size(), cloud) == Outcome::Refused, path + ": a damaged message");
      expect(hostile.decode(message.data(), cut, cloud) == Outcome::Refused, path + ": a cut message");
      expect(!hostile.why().empty(), path + ": a sentence that says why");
    }
  expect(hostile.decode(nullptr, 0, cloud) == Outcome::Refused, "no bytes");
}

int write_points(const std::string& path, const std::filesystem::path& out) {
  Decoder decoder;
  Cloud cloud;
  int count = 0;
  for (const Message& message : messages_of(path)) {
    if (decoder.decode(message.data(), message.size(), cloud) != Outcome::Decoded) {
      std::cout << decoder.why() << "\n";
      continue;
    }
    std::ofstream file(out / (std::to_string(count++) + ".points"), std::ios::binary);
    file.write(reinterpret_cast<const char*>(cloud.data.data()), static_cast<std::streamsize>(cloud.data.size()));
    for (const auto& field : cloud.fields) std::cout << field.name << " ";
    std::cout << cloud.point_step << "\n";
  }
  return 0;
}

}  // namespace

int main(int count, char** words) {
  try {
    if (count == 4 && std::string(words[1]) == "--points") return write_points(words[2], words[3]);
    for (int i = 1; i < count; ++i) test(words[i]);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
  return failures == 0 && count > 1 ? 0 : 1;
}
