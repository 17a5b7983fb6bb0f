// The two messages, with the MD5 sums by which both ends check that their definitions agree.
#pragma once

#include "bytes.h"

namespace dueppm {

// risc_msgs/Controls with exactly one object.
struct Controls {
  static constexpr const char* kTopic = "controls";
  static constexpr const char* kType = "risc_msgs/Controls";
  static constexpr const char* kMd5 = "5fa2036879cc2f7d0c75bc2dc1639156";

  Text name;
  double phi;
  double theta;
  double psi;
  double T;

  // Reads the message; false if the bytes are not exactly one such message. The header is ignored.
  bool read(const uint8_t* bytes, size_t length) {
    Reader reader(bytes, length);
    reader.u32();  // seq
    reader.u32();  // stamp
    reader.u32();
    reader.text();  // frame_id
    if (reader.u32() != 1) return false;
    name = reader.text();
    phi = reader.f64();
    theta = reader.f64();
    psi = reader.f64();
    T = reader.f64();
    return reader.at_end();
  }
};

// risc_maap_msgs/PpmStatus, with the same fields.
struct PpmStatus {
  static constexpr const char* kTopic = "ppm_status";
  static constexpr const char* kType = "risc_maap_msgs/PpmStatus";
  static constexpr const char* kMd5 = "03653cf3ec5261bc9f4c3a23b880adf4";
  static constexpr int kMostChannels = 8;

  uint32_t seq;
  uint32_t stamp_s;
  uint32_t stamp_ns;
  uint8_t state;
  uint8_t channels;
  uint16_t channels_us[kMostChannels];
  uint32_t accepted;
  uint32_t refused;
  uint8_t last_refusal;
  float age_s;
  uint32_t damaged_packets;
  float interrupt_delay_us;
  uint32_t late_periods;

  size_t write(uint8_t* bytes, size_t size) const {
    Writer writer(bytes, size);
    writer.u32(seq);
    writer.u32(stamp_s);
    writer.u32(stamp_ns);
    writer.u32(0);  // frame_id: empty
    writer.u8(state);
    writer.u32(channels);
    for (int i = 0; i < channels && i < kMostChannels; ++i) writer.u16(channels_us[i]);
    writer.u32(accepted);
    writer.u32(refused);
    writer.u8(last_refusal);
    writer.f32(age_s);
    writer.u32(damaged_packets);
    writer.f32(interrupt_delay_us);
    writer.u32(late_periods);
    return writer.good() ? writer.length() : 0;
  }
};

}  // namespace dueppm
