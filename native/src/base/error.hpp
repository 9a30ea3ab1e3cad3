// One exception for the whole native core: a code that says which error of lidarcodec/errors.py it is, and a sentence.
#pragma once
#include <cstddef>
#include <stdexcept>
#include <string>

namespace lidarcodec {

enum class ErrorCode { Packet, Header, Truncated, Checksum, Section, Settings };

class Error : public std::runtime_error {
 public:
  Error(ErrorCode code, const std::string& what, std::size_t offset = 0)
      : std::runtime_error(what), code_(code), offset_(offset) {}
  ErrorCode code() const { return code_; }
  std::size_t offset() const { return offset_; }

 private:
  ErrorCode code_;
  std::size_t offset_;
};

}  // namespace lidarcodec
