// ROS 1 serialization for the messages of this firmware: little-endian, unaligned, strings preceded by their
// length.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace dueppm {

struct Text {  // not terminated
  const uint8_t* bytes;
  size_t length;
};

inline Text text_of(const char* terminated) {
  Text text = {reinterpret_cast<const uint8_t*>(terminated), 0};
  while (terminated[text.length] != '\0') ++text.length;
  return text;
}

inline bool equal(Text a, Text b) {
  if (a.length != b.length) return false;
  for (size_t i = 0; i < a.length; ++i) {
    if (a.bytes[i] != b.bytes[i]) return false;
  }
  return true;
}

// Never reads beyond the end: a missing value reads as 0, and good() is false from then on.
class Reader {
 public:
  Reader(const uint8_t* bytes, size_t length) : next_(bytes), left_(length), good_(true) {}

  uint8_t u8() { return static_cast<uint8_t>(number(1)); }
  uint16_t u16() { return static_cast<uint16_t>(number(2)); }
  uint32_t u32() { return static_cast<uint32_t>(number(4)); }
  double f64() {
    static_assert(sizeof(double) == 8, "float64 needs a double of 8 bytes");
    const uint64_t bits = number(8);
    double value;
    __builtin_memcpy(&value, &bits, sizeof value);
    return value;
  }
  Text text() {
    Text text = {next_, u32()};
    text.bytes = next_;
    return take(text.length) ? text : Text{next_, 0};
  }

  bool good() const { return good_; }
  bool at_end() const { return good_ && left_ == 0; }

 private:
  bool take(size_t length) {
    if (length > left_) {
      good_ = false;
      left_ = 0;
      return false;
    }
    next_ += length;
    left_ -= length;
    return true;
  }
  uint64_t number(size_t length) {
    const uint8_t* bytes = next_;
    if (!take(length)) return 0;
    uint64_t value = 0;
    for (size_t i = length; i > 0; --i) value = value << 8 | bytes[i - 1];
    return value;
  }

  const uint8_t* next_;
  size_t left_;
  bool good_;
};

// Never writes beyond the end: a value that does not fit is left out, and good() is false from then on.
class Writer {
 public:
  Writer(uint8_t* bytes, size_t size) : bytes_(bytes), size_(size), length_(0), good_(true) {}

  void u8(uint8_t value) { number(value, 1); }
  void u16(uint16_t value) { number(value, 2); }
  void u32(uint32_t value) { number(value, 4); }
  void f32(float value) {
    static_assert(sizeof(float) == 4, "float32 needs a float of 4 bytes");
    uint32_t bits;
    __builtin_memcpy(&bits, &value, sizeof bits);
    u32(bits);
  }
  void text(Text text) {
    u32(static_cast<uint32_t>(text.length));
    for (size_t i = 0; i < text.length; ++i) u8(text.bytes[i]);
  }

  size_t length() const { return length_; }
  bool good() const { return good_; }

 private:
  void number(uint32_t value, size_t length) {
    if (!good_ || length > size_ - length_) {
      good_ = false;
      return;
    }
    for (size_t i = 0; i < length; ++i) bytes_[length_++] = static_cast<uint8_t>(value >> 8 * i);
  }

  uint8_t* bytes_;
  size_t size_;
  size_t length_;
  bool good_;
};

}  // namespace dueppm
