// JSON from elsewhere (RFC 8259), within the limits of lidarcodec/untrusted/json.py: no number beyond what a double
// holds, no whole one of more than 20 digits, no text with a zero character or half a surrogate pair.
#pragma once
#include <string>
#include <string_view>
#include <vector>

#include "base/bytes.hpp"

namespace lidarcodec {

struct JsonValue {
  enum class Kind : std::uint8_t { Null, Truth, Whole, Fraction, Text, List, Object };
  Kind kind = Kind::Null;
  double number = 0;  // of Whole and Fraction
  std::string text;
  std::vector<JsonValue> list;     // values of a list, or of the members of an object
  std::vector<std::string> names;  // of the members of an object

  bool is_number() const { return kind == Kind::Whole || kind == Kind::Fraction; }
  // The last member of that name; nullptr if there is none.
  const JsonValue* find(std::string_view name) const;
};

// The object that a document is. Raises Section.
JsonValue read_json_object(Bytes data);

}  // namespace lidarcodec
