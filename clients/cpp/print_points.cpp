// Prints the points of a live stream's messages, of any sensor, which come on the standard input: for each its size,
// u32 little endian, and then its bytes. README.md says how a subscription gives them.
//   print_points [--weights FOLDER]
#include <iostream>

#include "session.hpp"

namespace {

constexpr uint32_t kMostMessage = 64u << 20;

// Whether a message came; false at the end.
bool read_message(std::vector<uint8_t>& message) {
  unsigned char size[4];
  if (!std::cin.read(reinterpret_cast<char*>(size), sizeof(size))) return false;
  const uint32_t bytes = size[0] | uint32_t{size[1]} << 8 | uint32_t{size[2]} << 16 | uint32_t{size[3]} << 24;
  if (bytes > kMostMessage) throw std::runtime_error("a message of more than 64 MiB");
  message.resize(bytes);
  return static_cast<bool>(std::cin.read(reinterpret_cast<char*>(message.data()), bytes));
}

// A point, and what the frame's other planes, or the fields of its message, say of it.
void print(const Session& session, const lidarcodec_frame& frame, const lidarcodec_point& point) {
  std::cout << point.x << " " << point.y << " " << point.z;
  for (uint32_t i = 0; i < frame.plane_count; ++i) {
    const std::string name = frame.planes[i].name;
    if (frame.planes[i].role == LIDARCODEC_ATTRIBUTE && name.back() != '2')
      std::cout << ", " << name << " " << attribute_of(frame, point, name);
  }
  const std::vector<lidarcodec_field> fields = fields_of(session);
  for (size_t place = 0; place < fields.size(); ++place) {
    const std::string name = fields[place].name;
    if (name == "x" || name == "y" || name == "z") continue;  // printed already
    const std::vector<double> values = values_of(session, fields, place);
    std::cout << ", " << name;
    for (uint32_t i = 0; i < fields[place].count; ++i)
      std::cout << " " << values[size_t{point.cell} * fields[place].count + i];
  }
}

int run(const std::string& weights) {
  const Session session = open_session(weights);
  std::vector<uint8_t> message;
  while (read_message(message)) {
    lidarcodec_frame frame;
    const lidarcodec_status status = lidarcodec_push(session.get(), message.data(), message.size(), &frame);
    if (status == LIDARCODEC_MISSING_REFERENCE) {
      std::cerr << lidarcodec_error_text(session.get()) << "\n";  // a program on the network asks for a key frame here
    } else if (status != LIDARCODEC_OK) {
      std::cerr << "byte " << lidarcodec_error_offset(session.get()) << ": " << lidarcodec_error_text(session.get())
                << "\n";
    } else {
      do {
        const std::vector<lidarcodec_point> points = points_of(session, LIDARCODEC_ALL);
        std::cout << "frame " << frame.index << " of a " << frame.sensor << ": " << points.size() << " points";
        if (!points.empty()) {
          std::cout << ", the first at ";
          print(session, frame, points[0]);
        }
        std::cout << std::endl;
      } while (lidarcodec_next(session.get(), &frame) != 0);
    }
  }
  return 0;
}

}  // namespace

int main(int count, char** words) {
  if (count != 1 && (count != 3 || std::string(words[1]) != "--weights")) {
    std::cerr << "usage: print_points [--weights FOLDER] < MESSAGES\n";
    return 2;
  }
  try {
    return run(count == 3 ? words[2] : "");
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
