#include "subscriber.hpp"

#include <pluginlib/class_list_macros.hpp>
#include <rclcpp/logging.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <utility>

namespace lidarcodec_point_cloud_transport {
namespace {

constexpr const char* kFormat = "lidarcodec";

rclcpp::Logger logger() { return rclcpp::get_logger("lidarcodec_point_cloud_transport"); }

sensor_msgs::msg::PointCloud2::SharedPtr message_of(const Cloud& cloud, const std_msgs::msg::Header& header) {
  auto message = std::make_shared<sensor_msgs::msg::PointCloud2>();
  message->header = header;
  message->height = 1;
  message->width = cloud.points;
  for (const Field& field : cloud.fields) {
    sensor_msgs::msg::PointField described;
    described.name = field.name;
    described.offset = field.offset;
    described.datatype = field.datatype;
    described.count = field.count;
    message->fields.push_back(std::move(described));
  }
  message->is_bigendian = false;
  message->is_dense = cloud.dense;
  message->point_step = cloud.point_step;
  message->row_step = cloud.point_step * cloud.points;
  message->data = cloud.data;
  return message;
}

}  // namespace

Subscriber::DecodeResult Subscriber::decodeTyped(const Compressed& compressed) const {
  if (compressed.format != kFormat)
    return tl::make_unexpected("a compressed cloud of format '" + compressed.format + "', not '" + kFormat + "'");
  const std::lock_guard<std::mutex> lock(mutex_);
  try {
    if (!decoder_) decoder_ = std::make_unique<Decoder>();
    const auto& data = compressed.compressed_data;
    const Outcome outcome = decoder_->decode(data.data(), data.size(), cloud_);
    if (outcome == Outcome::Waiting) {
      if (!waiting_) RCLCPP_WARN(logger(), "waiting for the next key message: %s", decoder_->why().c_str());
      waiting_ = true;
      return std::nullopt;
    }
    if (outcome == Outcome::Refused) return tl::make_unexpected(decoder_->why());
  } catch (const std::exception& error) {
    return tl::make_unexpected(std::string(error.what()));
  }
  waiting_ = false;
  return message_of(cloud_, compressed.header);
}

}  // namespace lidarcodec_point_cloud_transport

PLUGINLIB_EXPORT_CLASS(lidarcodec_point_cloud_transport::Subscriber, point_cloud_transport::SubscriberPlugin)
