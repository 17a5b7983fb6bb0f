// cortex_decode_bench: how long it takes to decode a large frame (16 bodies with 5 markers each), as JSON.

#include <algorithm>
#include <chrono>
#include <iostream>
#include <string>
#include <vector>

#include "encode.hpp"

namespace {

constexpr int kBodies = 16;
constexpr int kMarkers = 5;
constexpr int kWarmUp = 2000;
constexpr int kIterations = 200000;

cortex_ros::Bytes large_frame() {
  cortex_ros::FrameOfData frame;
  frame.frame = 123456;
  for (int i = 0; i < kBodies; ++i) {
    cortex_ros::Body body{"vehicle_number_" + std::to_string(i), {}};
    for (int k = 0; k < kMarkers; ++k) {
      const auto offset = static_cast<float>(i * kMarkers + k);
      body.markers.push_back({1000.5f + offset, -2000.25f - offset, 1500.0f + offset});
    }
    frame.bodies.push_back(body);
  }
  frame.delay_s = 0.003f;
  return cortex_ros::encode(frame);
}

}  // namespace

int main() {
  using Clock = std::chrono::steady_clock;
  const cortex_ros::Bytes bytes = large_frame();
  std::vector<double> times_us;
  times_us.reserve(kIterations);
  std::size_t bodies = 0;  // used below, so that the work cannot be optimised away
  for (int i = -kWarmUp; i < kIterations; ++i) {
    const auto start = Clock::now();
    const cortex_ros::Packet packet = cortex_ros::decode(bytes.data(), bytes.size());
    const auto end = Clock::now();
    bodies += std::get<cortex_ros::FrameOfData>(packet).bodies.size();
    if (i >= 0) {
      times_us.push_back(std::chrono::duration<double, std::micro>(end - start).count());
    }
  }
  std::sort(times_us.begin(), times_us.end());
  std::cout << "{\"bodies\": " << bodies / (kIterations + kWarmUp) << ", \"markers\": " << kMarkers
            << ", \"bytes\": " << bytes.size() << ", \"iterations\": " << kIterations
            << ", \"median_us\": " << times_us[kIterations / 2]
            << ", \"p99_us\": " << times_us[kIterations / 100 * 99] << "}\n";
  return 0;
}
