// A frame of another sensor than an HDL-64E: planes, the rest of its packets, and the direction of each column; of a
// point cloud its message, no planes. In Python lidarcodec/image_frame.py.
#pragma once
#include "session/frames/described_sensor.hpp"
#include "session/frames/plane_section.hpp"
#include "session/frames/rest.hpp"

namespace lidarcodec {

struct ImageFrame {
  std::shared_ptr<const DescribedSensor> sensor;
  std::size_t width = 0;
  std::vector<NamedPlane> planes;    // (H, W) each, H the sensor's rows; none if all packets are odd
  std::vector<std::int32_t> shift;   // of its PLANES section: columns by which each row moves in a picture
  std::vector<std::size_t> lattice;  // the columns that were sent, ascending, where the frame was thinned to some
  PacketRest rest;
  std::shared_ptr<const DecodedCloud> cloud;  // of a point cloud, unless the program reads its section by itself
  const PacketLayout* layout = nullptr;       // of the sensor's family; nothing if all packets are odd
  std::vector<std::uint16_t> azimuth;  // (W,) 0.01 degree, 0 to 35999, clockwise; 0 without a layout, and of models
                                       // that only the program knows

  // nullptr if there is none.
  const NamedPlane* named(std::string_view name) const;
  const PlaneImage* plane(std::string_view name) const;
  // Directions and times of its cells; nothing without a layout, or where the directions of beams are not known.
  std::unique_ptr<FrameGeometry> geometry() const;
};

// The frame of a message. Raises Section, Truncated, or Reference where a key message has to come first.
ImageFrame read_image_frame(const Message& message, DescribedSensorBook& sensors, const Outside& outside,
                            PlaneMemory* memory);

}  // namespace lidarcodec
