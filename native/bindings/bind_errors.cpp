#include <string>

#include "base/error.hpp"
#include "bindings.hpp"

namespace {

const char* class_name(lidarcodec::ErrorCode code) {
  switch (code) {
    case lidarcodec::ErrorCode::Packet:
      return "PacketError";
    case lidarcodec::ErrorCode::Header:
      return "HeaderError";
    case lidarcodec::ErrorCode::Truncated:
      return "TruncatedError";
    case lidarcodec::ErrorCode::Checksum:
      return "ChecksumError";
    case lidarcodec::ErrorCode::Section:
      return "SectionError";
    case lidarcodec::ErrorCode::Settings:
      return "SettingsError";
    case lidarcodec::ErrorCode::Version:
      return "UnsupportedVersionError";
    case lidarcodec::ErrorCode::Reference:
      return "MissingReferenceError";
  }
  return "LidarCodecError";
}

}  // namespace

void bind_errors(nb::module_&) {
  nb::register_exception_translator([](const std::exception_ptr& thrown, void*) {
    try {
      std::rethrow_exception(thrown);
    } catch (const lidarcodec::Error& e) {
      nb::object error_class = nb::module_::import_("lidarcodec.errors").attr(class_name(e.code()));
      nb::object error =
          e.code() == lidarcodec::ErrorCode::Settings ? error_class(e.what()) : error_class(e.what(), e.offset());
      PyErr_SetObject(error_class.ptr(), error.ptr());
    }
  });
}
