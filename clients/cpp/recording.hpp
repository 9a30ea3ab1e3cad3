// Messages of lidarcodec out of an MCAP file (mcap.dev/spec), chunks uncompressed or compressed by zstd. A file without
// its end is read as far as it goes.
#pragma once
#include <zstd.h>

#include <cstdint>
#include <cstring>
#include <fstream>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

class Recording {
 public:
  explicit Recording(const std::string& path) : file_(path, std::ios::binary) {
    char magic[8] = {};
    if (!file_.read(magic, sizeof(magic)) || std::memcmp(magic, "\x89MCAP0\r\n", sizeof(magic)) != 0)
      throw std::runtime_error(path + " is not an MCAP file");
    const auto begin = file_.tellg();
    file_.seekg(0, std::ios::end);
    left_ = static_cast<uint64_t>(file_.tellg() - begin);
    file_.seekg(begin);
  }

  // Calls take(topic, data, size) with each message, in the order of the file.
  template <class Take>
  void read(const Take& take) {
    std::vector<uint8_t> record;
    for (char head[kHead]; left_ >= kHead && file_.read(head, kHead);) {
      const uint64_t size = number(reinterpret_cast<const uint8_t*>(head) + 1, 8);
      left_ -= kHead;
      if (size > left_) return;  // the file was cut
      record.resize(size);
      if (!file_.read(reinterpret_cast<char*>(record.data()), static_cast<std::streamsize>(size))) return;
      left_ -= size;
      one(static_cast<uint8_t>(head[0]), record.data(), size, take);
    }
  }

 private:
  static constexpr uint64_t kHead = 9, kMostChunk = uint64_t{1} << 30;
  static constexpr uint8_t kChannel = 4, kMessage = 5, kChunk = 6;

  // The next bytes of a record.
  class Fields {
   public:
    Fields(const uint8_t* data, uint64_t size) : data_(data), left_(size) {}
    const uint8_t* bytes(uint64_t size) {
      if (size > left_) throw std::runtime_error("a record of the file ends within one of its fields");
      data_ += size;
      left_ -= size;
      return data_ - size;
    }
    uint64_t number(unsigned size) { return Recording::number(bytes(size), size); }
    std::string text() {
      const uint64_t size = number(4);
      const uint8_t* const from = bytes(size);
      return {from, from + size};
    }
    uint64_t left() const { return left_; }

   private:
    const uint8_t* data_;
    uint64_t left_;
  };

  static uint64_t number(const uint8_t* from, unsigned size) {
    uint64_t value = 0;
    for (unsigned i = size; i-- > 0;) value = value << 8 | from[i];
    return value;
  }

  template <class Take>
  void one(uint8_t kind, const uint8_t* data, uint64_t size, const Take& take) {
    Fields fields(data, size);
    if (kind == kChannel) {
      const uint64_t id = fields.number(2);
      fields.number(2);  // schema
      const std::string topic = fields.text();
      if (fields.text() == "lidarcodec") topics_[id] = topic;
    } else if (kind == kMessage) {
      const auto topic = topics_.find(fields.number(2));
      fields.bytes(20);  // sequence, log time, publish time
      if (topic != topics_.end()) take(topic->second, fields.bytes(0), static_cast<size_t>(fields.left()));
    } else if (kind == kChunk) {
      fields.bytes(16);  // times
      const uint64_t plain = fields.number(8);
      fields.number(4);  // checksum
      const std::string compression = fields.text();
      const uint64_t packed = fields.number(8);
      const uint8_t* records = fields.bytes(packed);
      if (compression == "zstd") {
        if (plain > kMostChunk) throw std::runtime_error("a chunk of more than 1 GiB");
        std::vector<uint8_t> opened(plain);
        if (ZSTD_decompress(opened.data(), plain, records, packed) != plain)
          throw std::runtime_error("a damaged chunk");
        chunk(opened.data(), plain, take);
      } else if (compression.empty()) {
        chunk(records, packed, take);
      } else {
        throw std::runtime_error("chunks compressed by " + compression + " are not read here");
      }
    }
  }

  template <class Take>
  void chunk(const uint8_t* data, uint64_t size, const Take& take) {
    for (Fields fields(data, size); fields.left() > 0;) {
      const auto kind = static_cast<uint8_t>(fields.number(1));
      const uint64_t length = fields.number(8);
      if (kind != kChunk)
        one(kind, fields.bytes(length), length, take);
      else
        fields.bytes(length);
    }
  }

  std::ifstream file_;
  uint64_t left_ = 0;
  std::map<uint64_t, std::string> topics_;
};
