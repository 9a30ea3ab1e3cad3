// Subscriber: the transport `lidarcodec` of point_cloud_transport. Publishers are the bridge of lidarcodec, and bags.
#pragma once
#include <memory>
#include <mutex>
#include <point_cloud_interfaces/msg/compressed_point_cloud2.hpp>
#include <point_cloud_transport/simple_subscriber_plugin.hpp>
#include <string>

#include "decoder.hpp"

namespace lidarcodec_point_cloud_transport {

class Subscriber
    : public point_cloud_transport::SimpleSubscriberPlugin<point_cloud_interfaces::msg::CompressedPointCloud2> {
 public:
  using Compressed = point_cloud_interfaces::msg::CompressedPointCloud2;

  // Overrides what ROS 2 up to Jazzy asks for. Later plug-ins of point_cloud_transport itself do not have it any more.
  std::string getTransportName() const { return "lidarcodec"; }
  std::string getDataType() const override { return "point_cloud_interfaces/msg/CompressedPointCloud2"; }
  void declareParameters() override {}

  // The points of a message; empty while it waits for a key message; an error for what cannot be decoded.
  DecodeResult decodeTyped(const Compressed& compressed) const override;

 private:
  // The transport asks a constant object, but messages build on those before.
  mutable std::mutex mutex_;
  mutable std::unique_ptr<Decoder> decoder_;
  mutable Cloud cloud_;
  mutable bool waiting_ = false;
};

}  // namespace lidarcodec_point_cloud_transport
