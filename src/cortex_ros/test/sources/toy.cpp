// A source of motion capture for tests: one file and one YAML, as the README says.

#include <chrono>
#include <condition_variable>
#include <limits>
#include <mutex>

#include "cortex_ros/parameters.hpp"
#include "cortex_ros/sources/mocap_source.hpp"

namespace {

using namespace cortex_ros;  // NOLINT

class ToySource : public MocapSource {
 public:
  ToySource(Parameters& parameters, SourceEvents& events, const Clock& clock)
      : events_(events), clock_(clock) {
    parameters.read("body", body_);
    parameters.read("rate", rate_hz_);
    parameters.read("reported_delay", delay_s_);
    parameters.read("up_axis", up_axis_);
  }

  // Every tenth number is missing and every frame comes twice, as on a bad network.
  void run() override {
    MocapHost host{"a toy", rate_hz_, up_axis_.at(0), {"a toy sees nothing"}};
    events_.on_host_up(host);
    constexpr double kMissing = std::numeric_limits<double>::quiet_NaN();
    std::unique_lock<std::mutex> lock(mutex_);
    for (std::int32_t number = 1; !stop_; ++number) {
      if (number % 10 != 0) {
        MocapFrame frame{number, clock_.wall(), delay_s_, {}, {{0.0, 0.0, 1.0}}};
        frame.bodies = {{body_, {{1.0, 2.0, 3.0}, {kMissing, kMissing, kMissing}}, 0.002}};
        events_.on_frame(frame);
        events_.on_frame(frame);
      }
      wake_.wait_for(lock, std::chrono::duration<double>(1.0 / rate_hz_), [this] { return stop_; });
    }
  }

  void stop() noexcept override {
    const std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
    wake_.notify_all();
  }

  SourceStatus status() const override { return {true, "toy box", "", "spring", {}, {{"springs", 7}}}; }

 private:
  SourceEvents& events_;
  const Clock& clock_;
  std::string body_;
  double rate_hz_ = 0.0;
  double delay_s_ = 0.0;
  std::string up_axis_ = "z";
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
};

const RegisteredSource kToy("toy",
                            [](Parameters& parameters, SourceEvents& events,
                               const Clock& clock) -> std::unique_ptr<MocapSource> {
                              return std::make_unique<ToySource>(parameters, events, clock);
                            });

}  // namespace
