#include "session/frames/image_frame.hpp"

#include <algorithm>

#include "session/frames/picture_ranges.hpp"
#include "session/lattice.hpp"

namespace lidarcodec {
namespace {

[[noreturn]] void damaged(const std::string& what) { throw Error(ErrorCode::Section, what); }

// Series get the types of the layout: a message may say others that hold their numbers. Raises Section if these are not
// the series of so many packets of a layout.
void take_series(const PacketLayout& layout, std::vector<Series>& series, std::size_t packets) {
  if (series.size() != layout.series.size()) damaged("series that are not those of the layout");
  for (const SeriesPlan& plan : layout.series) {
    const std::vector<std::uint64_t>& values = series_named(series, plan.name);
    if (values.size() != packets * plan.each)
      damaged("series " + std::string(plan.name) + " has " + std::to_string(values.size()) + " numbers, not " +
              std::to_string(packets * plan.each));
    const std::uint64_t most = plan.bytes == 8 ? ~std::uint64_t{0} : (std::uint64_t{1} << (8 * plan.bytes)) - 1;
    if (std::any_of(values.begin(), values.end(), [&](std::uint64_t value) { return value > most; }))
      damaged("series " + std::string(plan.name) + " holds numbers that are too large");
  }
  for (Series& one : series)
    one.bytes = std::find_if(layout.series.begin(), layout.series.end(), [&](const SeriesPlan& plan) {
                  return plan.name == one.name;
                })->bytes;
}

constexpr std::size_t kMostNumbers = std::size_t{5} << 20;  // of all planes of a frame
constexpr std::uint32_t kMostIntensityBits = 16;

// Planes of the columns that were sent, in those of the frame.
void widen(const Lattice& lattice, ImageFrame& frame) {
  const std::size_t rows = frame.sensor->rows();
  if (rows * lattice.width * frame.planes.size() > kMostNumbers)
    damaged("a thinned frame of more numbers than a frame may have");
  for (NamedPlane& plane : frame.planes) plane.values = widened(plane.values, rows, lattice);
  frame.lattice = lattice.columns;
}

// Of a point cloud there are no images: the sensor, the host time of its message, and this.
void read_cloud(const Message& message, ImageFrame& frame, const Outside& outside) {
  const PacketRest& rest = frame.rest;
  if (rest.packet_ns.size() != 1 || !rest.layout.empty() || !rest.odd.empty())
    damaged("a point cloud of " + std::to_string(rest.packet_ns.size()) + " packets, not of one message");
  frame.width = 0;
  frame.cloud = outside.cloud(message.section(SectionType::Cloud));
}

void take_layout(ImageFrame& frame) {
  const DescribedSensor& sensor = *frame.sensor;
  const std::string& name = frame.rest.layout;
  frame.azimuth.assign(frame.width, 0);
  if (name.empty() || !is_known_model(sensor.model)) return;
  frame.layout = sensor.family == nullptr ? nullptr : sensor.family->layout(name);
  if (frame.layout == nullptr) damaged("a layout '" + name + "' that sensor " + sensor.model + " does not have");
  const std::size_t packets = frame.rest.packet_ns.size() - frame.rest.odd.size();
  if (sensor.rows() != sensor.family->rows() || frame.width != packets * frame.layout->columns)
    damaged("planes " + std::to_string(sensor.rows()) + " x " + std::to_string(frame.width) + " of " +
            std::to_string(packets) + " packets of " + std::to_string(sensor.family->rows()) + " x " +
            std::to_string(frame.layout->columns));
  take_series(*frame.layout, frame.rest.series, packets);
  frame.azimuth = sensor.family->azimuth(*frame.layout, frame.rest.series);
}

}  // namespace

const NamedPlane* ImageFrame::named(std::string_view name) const {
  const auto found =
      std::find_if(planes.begin(), planes.end(), [&](const NamedPlane& one) { return one.name == name; });
  return found == planes.end() ? nullptr : &*found;
}

const PlaneImage* ImageFrame::plane(std::string_view name) const {
  const NamedPlane* const found = named(name);
  return found == nullptr ? nullptr : &found->values;
}

std::unique_ptr<FrameGeometry> ImageFrame::geometry() const {
  return layout == nullptr ? nullptr : sensor->family->geometry(*layout, rest.series, sensor->table);
}

ImageFrame read_image_frame(const Message& message, DescribedSensorBook& sensors, const Outside& outside,
                            PlaneMemory* memory) {
  if (message.frame_count != 1 || (message.needs && memory == nullptr))
    damaged("a message of planes with several frames, or that refers to another");
  ImageFrame frame;
  frame.sensor = sensors.of(message, outside);
  frame.width = message.width;
  frame.rest = decode_rest(message.section(SectionType::Rest), message.packets, outside);
  if (frame.sensor->model == kPointCloud) {
    read_cloud(message, frame, outside);
    return frame;
  }
  std::optional<Lattice> lattice;
  if (const std::optional<Bytes> section = message.find(SectionType::Lattice)) {
    lattice = read_lattice(*section, outside);
    if (lattice->width != frame.width || lattice->packets)
      damaged("a lattice in " + std::to_string(lattice->width) + " columns, or with packets, in a message of " +
              std::to_string(frame.width));
  }
  if (const std::optional<Bytes> section = message.find(SectionType::Planes)) {
    const std::size_t columns = lattice ? lattice->columns.size() : frame.width;
    PlaneSection found = decode_plane_section(*section, columns, outside, memory);
    if (found.rows != frame.sensor->rows())
      damaged("planes of " + std::to_string(found.rows) + " rows of a sensor with " +
              std::to_string(frame.sensor->rows()));
    if (is_exact_picture(message.codec)) take_picture(message, outside, columns, found);
    frame.planes = std::move(found.planes);
    frame.shift = std::move(found.shift);
    if (lattice) widen(*lattice, frame);
    if (const NamedPlane* const intensity = frame.named("intensity"); intensity && intensity->bits > kMostIntensityBits)
      damaged("intensities of " + std::to_string(intensity->bits) + " bits, more than " +
              std::to_string(kMostIntensityBits));
  } else if (message.width != 0 || !frame.rest.layout.empty()) {
    damaged("a message of " + std::to_string(message.width) + " columns without planes");
  } else if (is_exact_picture(message.codec) && message.has(SectionType::Range)) {
    damaged("a picture of a frame without planes");
  }
  take_layout(frame);
  return frame;
}

}  // namespace lidarcodec
