// Messages of a host, for the tests.
#pragma once

#include <cstring>
#include <string>
#include <vector>

namespace host {

using Bytes = std::vector<uint8_t>;

inline uint8_t check(const Bytes& bytes, size_t first, size_t end) {
  unsigned sum = 0;
  for (size_t i = first; i < end; ++i) sum += bytes[i];
  return static_cast<uint8_t>(255 - sum % 256);
}

inline Bytes packet(unsigned topic, const Bytes& payload) {
  Bytes bytes = {0xff, 0xfe, static_cast<uint8_t>(payload.size()), static_cast<uint8_t>(payload.size() >> 8)};
  bytes.push_back(check(bytes, 2, 4));
  bytes.push_back(static_cast<uint8_t>(topic));
  bytes.push_back(static_cast<uint8_t>(topic >> 8));
  bytes.insert(bytes.end(), payload.begin(), payload.end());
  bytes.push_back(check(bytes, 5, bytes.size()));
  return bytes;
}

template <class T>
void put(Bytes& bytes, T value) {
  uint8_t raw[sizeof value];
  std::memcpy(raw, &value, sizeof value);
  bytes.insert(bytes.end(), raw, raw + sizeof value);
}

inline void put(Bytes& bytes, const std::string& text) {
  put(bytes, static_cast<uint32_t>(text.size()));
  bytes.insert(bytes.end(), text.begin(), text.end());
}

// Payload of risc_msgs/Controls with `objects` equal objects.
inline Bytes controls(double phi, double theta, double psi, double T, const std::string& name = "IRIS",
                      uint32_t objects = 1) {
  Bytes bytes;
  for (uint32_t value : {7u, 1700000000u, 5u}) put(bytes, value);  // seq, stamp
  put(bytes, std::string("cortex"));
  put(bytes, objects);
  for (uint32_t i = 0; i < objects; ++i) {
    put(bytes, name);
    for (double value : {phi, theta, psi, T}) put(bytes, value);
  }
  return bytes;
}

constexpr unsigned kControls = 100;

}  // namespace host
