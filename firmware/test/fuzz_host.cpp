// fuzz_host STEPS SEED: makes that many calls of the library's C interface, in random order and sizes.
//
// Checked at all times: edges alternate and do not go back in time; from the second frame after a reset on,
// each frame has its length, its gap, and its channels within their limits. Prints statistics; on a violation
// prints what was broken and exits with 1.
#include <cstdio>
#include <cstdlib>
#include <random>

#include "../dueppm/configuration.h"
#include "../host/dueppm_host.h"
#include "messages_of_host.h"

namespace {

using C = dueppm::Configuration;
using host::Bytes;

[[noreturn]] void broken(const char* what, double value) {
  std::printf("BROKEN: %s: %g\n", what, value);
  std::exit(1);
}

class Fuzz {
 public:
  explicit Fuzz(unsigned seed) : random_(seed), board_(dueppm_new()) {}
  ~Fuzz() { dueppm_free(board_); }
  Fuzz(const Fuzz&) = delete;
  Fuzz& operator=(const Fuzz&) = delete;

  void run(uint64_t steps) {
    for (uint64_t i = 0; i < steps; ++i) {
      const uint32_t pick = random_() % 1000;
      if (pick < 700) {  // a flight: every command is accepted
        receive(host::packet(host::kControls, host::controls(0.1, 0.0, 0.0, -1)));
        advance(22000);
        take_edges(64);
        send(256);
      } else if (pick < 800) {
        receive(noise(random_() % 100));
      } else if (pick < 850) {
        receive(host::packet(random_() % 130, noise(random_() % 600)));
      } else if (pick < 900) {
        receive(host::packet(0, {}));
      } else if (pick < 950) {
        advance(random_() % 300000);
      } else if (pick < 970) {
        take_edges(random_() % 200);
      } else if (pick < 990) {
        send(random_() % 2000);
      } else if (pick < 994) {
        reset();
      } else if (pick < 996) {
        dueppm_advance(board_, now_us_ / 2);  // a time in the past has no effect
      } else if (pick < 997) {
        receive(noise(random_() % 100000));  // more than the line buffers
      } else if (pick < 998) {
        advance(20000000);  // more edges and bytes than are buffered
        forget_frame();
        take_edges(8192);
      } else {
        dueppm_free(board_);
        board_ = dueppm_new();
        now_us_ = last_ticks_ = 0;
        forget_frame();
      }
    }
    std::printf("%llu frames, %llu commanded frames, %llu packets, %u resets\n", frames_, commanded_,
                packets_, resets_);
  }

 private:
  Bytes noise(size_t count) {
    Bytes bytes(count);
    for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random_());
    return bytes;
  }

  void receive(const Bytes& bytes) { dueppm_receive(board_, bytes.data(), bytes.size()); }

  void advance(uint64_t us) { dueppm_advance(board_, now_us_ += us); }

  void reset() {
    take_edges(8192);  // all of them: later edges belong to another start
    dueppm_reset(board_);
    ++resets_;
    forget_frame();
  }

  void send(size_t most) {
    Bytes bytes(most);
    const size_t count = dueppm_send(board_, bytes.data(), most);
    if (count > most) broken("bytes sent", static_cast<double>(count));
    for (size_t i = 0; i + 1 < count; ++i) packets_ += bytes[i] == 0xff && bytes[i + 1] == 0xfe;
  }

  void take_edges(size_t most) {
    std::vector<dueppm_edge> edges(most);
    const size_t count = dueppm_edges(board_, edges.data(), most);
    if (count > most) broken("edges", static_cast<double>(count));
    for (size_t i = 0; i < count; ++i) edge(edges[i]);
  }

  void edge(const dueppm_edge& edge) {
    if (edge.level == level_) broken("two edges of one level", edge.level);
    if (edge.time_ticks < last_ticks_) broken("time", static_cast<double>(edge.time_ticks));
    if (edge.time_ticks > now_us_ * 42) broken("an edge of the future", static_cast<double>(edge.time_ticks));
    level_ = edge.level;
    last_ticks_ = edge.time_ticks;
    if (edge.level != int{C::kPulseHigh}) return;
    if (leading_ > 0) period(static_cast<double>(edge.time_ticks - leading_) / 42);
    leading_ = edge.time_ticks;
  }

  void period(double us) {
    sum_us_ += us;
    const bool is_gap = us > C::kLongestUs;
    if (!is_gap) {
      if (us < C::kShortestUs || ++channels_ > C::kChannels) broken("channel", us);
      if (channels_ == 1) roll_us_ = us;
      return;
    }
    if (synchronised_) {
      if (us < 3000) broken("gap", us);
      if (channels_ != C::kChannels) broken("channels", channels_);
      if (sum_us_ < C::kFrameUs - 0.01 || sum_us_ > C::kFrameUs + 0.01) broken("length of a frame", sum_us_);
      ++frames_;
      if (roll_us_ > 1549.9 && roll_us_ < 1550.1) ++commanded_;
    }
    synchronised_ = true;
    channels_ = 0;
    sum_us_ = 0;
  }

  // Called when edges are missing, or the board restarts.
  void forget_frame() {
    level_ = -1;
    leading_ = 0;
    channels_ = 0;
    sum_us_ = 0;
    synchronised_ = false;
  }

  std::mt19937 random_;
  void* board_;
  uint64_t now_us_ = 0;
  uint64_t last_ticks_ = 0;
  uint64_t leading_ = 0;  // the last pulse's leading edge, 0: none yet
  int level_ = -1;
  int channels_ = 0;  // of the frame being received
  double sum_us_ = 0;
  double roll_us_ = 0;
  bool synchronised_ = false;
  unsigned long long frames_ = 0, commanded_ = 0, packets_ = 0;
  unsigned resets_ = 0;
};

}  // namespace

int main(int count, char** words) {
  if (count != 3) {
    std::fputs("usage: fuzz_host STEPS SEED\n", stderr);
    return 2;
  }
  Fuzz(static_cast<unsigned>(std::strtoul(words[2], nullptr, 10))).run(std::strtoull(words[1], nullptr, 10));
  return 0;
}
