// cortex_decode_bench: how long it takes to decode a large frame (16 bodies with 5 markers each).

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <iomanip>
#include <iostream>
#include <string>
#include <vector>

#include "encode.hpp"

namespace {

constexpr int kBodies = 16;
constexpr int kMarkers = 5;
constexpr int kWarmUp = 2000;

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

double percentile(const std::vector<double>& sorted, double fraction) {
  return sorted[static_cast<std::size_t>(fraction * static_cast<double>(sorted.size() - 1))];
}

}  // namespace

int main(int argc, char** argv) {
  using Clock = std::chrono::steady_clock;
  bool json = false;
  long iterations = 200000;
  CLI::App app("How long it takes to decode a frame of 16 bodies with 5 markers each.");
  app.add_option("iterations", iterations, "number of frames")
      ->check(CLI::Range(1, 1000000000))
      ->capture_default_str();
  app.add_flag("--json", json, "print the result as JSON");
  CLI11_PARSE(app, argc, argv);

  const cortex_ros::Bytes bytes = large_frame();
  std::vector<double> times_us(static_cast<std::size_t>(iterations));
  std::size_t bodies = 0;  // used below, so that the work cannot be optimised away
  for (long i = -kWarmUp; i < iterations; ++i) {
    const auto start = Clock::now();
    const cortex_ros::Packet packet = cortex_ros::decode(bytes.data(), bytes.size());
    const auto end = Clock::now();
    bodies += std::get<cortex_ros::FrameOfData>(packet).bodies.size();
    if (i >= 0) {
      times_us[static_cast<std::size_t>(i)] = std::chrono::duration<double, std::micro>(end - start).count();
    }
  }
  std::sort(times_us.begin(), times_us.end());
  const double median_us = percentile(times_us, 0.5);
  const double p99_us = percentile(times_us, 0.99);
  if (bodies != static_cast<std::size_t>(iterations + kWarmUp) * kBodies) {
    std::cerr << "cortex_decode_bench: decoded " << bodies << " bodies, which is wrong\n";
    return 1;
  }
  std::cout << std::fixed << std::setprecision(3);
  if (json) {
    std::cout << "{\"bodies\": " << kBodies << ", \"markers\": " << kMarkers
              << ", \"bytes\": " << bytes.size() << ", \"iterations\": " << iterations
              << ", \"median_us\": " << median_us << ", \"p99_us\": " << p99_us << "}\n";
  } else {
    std::cout << "decode of a frame of " << kBodies << " bodies x " << kMarkers << " markers ("
              << bytes.size() << " bytes), " << iterations << " times: median " << median_us << " us, p99 "
              << p99_us << " us\n";
  }
  return 0;
}
