// Builds packets byte by byte, valid or not, without the encoder under test.
#pragma once

#include <cstdint>
#include <cstring>
#include <string>

#include "cortex_ros/protocol.hpp"

class RawPacket {
 public:
  explicit RawPacket(std::uint16_t command) : command_(command) {}

  RawPacket& u16(unsigned value) { return little_endian(value, 2); }
  RawPacket& i32(std::int64_t value) { return little_endian(static_cast<std::uint64_t>(value), 4); }
  RawPacket& f32(float value) {
    std::uint32_t bits = 0;
    std::memcpy(&bits, &value, sizeof bits);
    return little_endian(bits, 4);
  }
  RawPacket& f64(double value) {
    std::uint64_t bits = 0;
    std::memcpy(&bits, &value, sizeof bits);
    return little_endian(bits, 8);
  }
  RawPacket& text(const std::string& value) { return letters(value).fill(1, 0); }
  RawPacket& letters(const std::string& value) {
    payload_.insert(payload_.end(), value.begin(), value.end());
    return *this;
  }
  RawPacket& raw(const cortex_ros::Bytes& value) {
    payload_.insert(payload_.end(), value.begin(), value.end());
    return *this;
  }
  RawPacket& fill(std::size_t n, std::uint8_t value) {
    payload_.insert(payload_.end(), n, value);
    return *this;
  }

  cortex_ros::Bytes bytes() const { return bytes_declaring(payload_.size()); }

  // The packet with this length field, which may be wrong.
  cortex_ros::Bytes bytes_declaring(std::size_t length) const {
    RawPacket header(0);
    header.u16(command_).u16(static_cast<unsigned>(length));
    cortex_ros::Bytes out = header.payload_;
    out.insert(out.end(), payload_.begin(), payload_.end());
    return out;
  }

 private:
  RawPacket& little_endian(std::uint64_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) {
      payload_.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
    }
    return *this;
  }

  std::uint16_t command_;
  cortex_ros::Bytes payload_;
};
