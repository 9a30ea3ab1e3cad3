// One exception for the whole native core: a code that says which error of lidarcodec/errors.py it is, and a sentence.
#pragma once
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>

namespace lidarcodec {

// Version: UnsupportedVersionError; Reference: MissingReferenceError.
enum class ErrorCode { Packet, Header, Truncated, Checksum, Section, Settings, Version, Reference };

class Error : public std::runtime_error {
 public:
  // offset: the byte at which it was seen; of Reference the index of the frame that is needed.
  Error(ErrorCode code, const std::string& what, std::uint64_t offset = 0)
      : std::runtime_error(what), code_(code), offset_(offset) {}
  ErrorCode code() const { return code_; }
  std::uint64_t offset() const { return offset_; }

 private:
  ErrorCode code_;
  std::uint64_t offset_;
};

}  // namespace lidarcodec
