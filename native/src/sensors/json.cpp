#include "sensors/json.hpp"

#include <algorithm>
#include <cmath>

#include "base/utf8.hpp"

namespace lidarcodec {
namespace {

constexpr std::size_t kMostBytes = 64 * 1024, kMostDigits = 20;
constexpr int kMostDepth = 16, kMostExponent = 100'000;

[[noreturn]] void refuse(const char* why) {
  throw Error(ErrorCode::Section, std::string("a sensor's description that cannot be read: ") + why);
}

class Parser {
 public:
  explicit Parser(Bytes data) : data_(data) {}

  JsonValue document() {
    JsonValue value = any(0);
    skip_space();
    if (at_ != data_.size()) refuse("bytes after its end");
    return value;
  }

 private:
  int peek() const { return at_ < data_.size() ? data_[at_] : -1; }
  int next() {
    if (at_ == data_.size()) refuse("it ends too early");
    return data_[at_++];
  }
  void skip_space() {
    while (peek() == ' ' || peek() == '\t' || peek() == '\n' || peek() == '\r') ++at_;
  }
  void expect(std::string_view word) {
    for (const char one : word)
      if (next() != one) refuse("it is not JSON");
  }
  bool is_digit() const { return peek() >= '0' && peek() <= '9'; }

  JsonValue any(int depth) {
    skip_space();
    JsonValue value;
    switch (peek()) {
      case '{':
      case '[':
        if (depth == kMostDepth) refuse("it is nested more than 16 deep");
        return peek() == '{' ? object(depth + 1) : list(depth + 1);
      case '"':
        value.kind = JsonValue::Kind::Text;
        value.text = text();
        return value;
      case 't':
      case 'f':
        value.kind = JsonValue::Kind::Truth;
        expect(peek() == 't' ? "true" : "false");
        return value;
      case 'n':
        expect("null");
        return value;
      default:
        return number();
    }
  }

  JsonValue object(int depth) {
    JsonValue value;
    value.kind = JsonValue::Kind::Object;
    ++at_;
    skip_space();
    if (peek() == '}') return ++at_, value;
    for (;;) {
      skip_space();
      if (peek() != '"') refuse("a member without a name");
      value.names.push_back(text());
      skip_space();
      expect(":");
      value.list.push_back(any(depth));
      if (!goes_on('}')) return value;
    }
  }

  JsonValue list(int depth) {
    JsonValue value;
    value.kind = JsonValue::Kind::List;
    ++at_;
    skip_space();
    if (peek() == ']') return ++at_, value;
    do value.list.push_back(any(depth));
    while (goes_on(']'));
    return value;
  }

  // Whether a comma comes, and not the end.
  bool goes_on(int end) {
    skip_space();
    const int found = next();
    if (found != ',' && found != end) refuse("it is not JSON");
    return found == ',';
  }

  JsonValue number() {
    JsonValue value;
    value.kind = JsonValue::Kind::Whole;
    const bool negative = peek() == '-';
    if (negative) ++at_;
    if (!is_digit()) refuse("it is not JSON");
    double digits = 0;
    int exponent = 0;
    const std::size_t start = at_;
    if (peek() == '0')
      ++at_;
    else
      for (; is_digit(); ++at_) digits = 10 * digits + (data_[at_] - '0');
    const std::size_t whole = at_ - start;
    if (peek() == '.') {
      value.kind = JsonValue::Kind::Fraction;
      ++at_;
      if (!is_digit()) refuse("it is not JSON");
      for (; is_digit(); ++at_)
        if (digits < 1e18) {  // what comes after is less than a double tells apart
          digits = 10 * digits + (data_[at_] - '0');
          --exponent;
        }
    }
    if (peek() == 'e' || peek() == 'E') {
      value.kind = JsonValue::Kind::Fraction;
      ++at_;
      const bool down = peek() == '-';
      if (down || peek() == '+') ++at_;
      if (!is_digit()) refuse("it is not JSON");
      int given = 0;
      for (; is_digit(); ++at_) given = std::min(10 * given + (data_[at_] - '0'), kMostExponent);
      exponent += down ? -given : given;
    }
    if (value.kind == JsonValue::Kind::Whole && whole > kMostDigits) refuse("a number of more than 20 digits");
    value.number = exponent < 0 ? digits / std::pow(10.0, -exponent) : digits * std::pow(10.0, exponent);
    if (digits == 0) value.number = 0;
    if (!std::isfinite(value.number)) refuse("a number that is out of range");
    if (negative) value.number = -value.number;
    return value;
  }

  unsigned hex4() {
    unsigned value = 0;
    for (int i = 0; i < 4; ++i) {
      const int one = next();
      const int digit = one >= '0' && one <= '9'   ? one - '0'
                        : one >= 'a' && one <= 'f' ? one - 'a' + 10
                        : one >= 'A' && one <= 'F' ? one - 'A' + 10
                                                   : -1;
      if (digit < 0) refuse("it is not JSON");
      value = value << 4 | static_cast<unsigned>(digit);
    }
    return value;
  }

  // A character of an escape, as UTF-8.
  void put(std::string& out, unsigned point) {
    const auto more = [&](unsigned shift) { out.push_back(static_cast<char>(0x80 | (point >> shift & 0x3F))); };
    if (point < 0x80) {
      out.push_back(static_cast<char>(point));
    } else if (point < 0x800) {
      out.push_back(static_cast<char>(0xC0 | point >> 6));
      more(0);
    } else if (point < 0x10000) {
      out.push_back(static_cast<char>(0xE0 | point >> 12));
      more(6);
      more(0);
    } else {
      out.push_back(static_cast<char>(0xF0 | point >> 18));
      more(12);
      more(6);
      more(0);
    }
  }

  std::string text() {
    std::string out;
    ++at_;
    for (;;) {
      const int one = next();
      if (one == '"') return out;
      if (one < 0x20) refuse("a text with a control character");
      if (one != '\\') {
        out.push_back(static_cast<char>(one));
        continue;
      }
      constexpr std::string_view kNames = "\"\\/bfnrt", kMeant = "\"\\/\b\f\n\r\t";
      const int name = next();
      if (const std::size_t at = kNames.find(static_cast<char>(name)); at != std::string_view::npos) {
        out.push_back(kMeant[at]);
        continue;
      }
      if (name != 'u') refuse("it is not JSON");
      unsigned point = hex4();
      if (point >= 0xD800 && point < 0xDC00) {
        expect("\\u");
        const unsigned low = hex4();
        if (low < 0xDC00 || low > 0xDFFF) refuse("a text has half a surrogate pair");
        point = 0x10000 + ((point - 0xD800) << 10) + (low - 0xDC00);
      } else if (point >= 0xDC00 && point <= 0xDFFF) {
        refuse("a text has half a surrogate pair");
      }
      if (point == 0) refuse("a text has a zero character");
      put(out, point);
    }
  }

  Bytes data_;
  std::size_t at_ = 0;
};

}  // namespace

const JsonValue* JsonValue::find(std::string_view name) const {
  if (kind != Kind::Object) return nullptr;
  for (std::size_t i = names.size(); i-- > 0;)
    if (names[i] == name) return &list[i];
  return nullptr;
}

JsonValue read_json_object(Bytes data) {
  if (data.size() > kMostBytes) refuse("it has more than 65536 bytes");
  if (!is_utf8(data)) refuse("it is not UTF-8");
  JsonValue value = Parser(data).document();
  if (value.kind != JsonValue::Kind::Object) refuse("it is not a JSON object");
  return value;
}

}  // namespace lidarcodec
