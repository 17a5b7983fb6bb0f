#include "dueppm_host.h"

#include <algorithm>
#include <deque>
#include <new>

#include "../dueppm/firmware.h"

namespace {

using Configuration = dueppm::Configuration;
using dueppm::kTicksPerUs;

constexpr uint64_t kByteTicks = 10ull * 1000000 * kTicksPerUs / Configuration::kBaud;  // 8N1
constexpr uint64_t kLoopTicks = 250 * kTicksPerUs;     // loop() runs at least this often, and with each byte
constexpr uint64_t kStartTicks = 20000 * kTicksPerUs;  // from reset to setup()
constexpr size_t kMostEdges = 4096;
constexpr size_t kMostBytes = 65536;

// Timer counter 0 with its output, and a serial line in both directions. Events run in order of time.
class Board {
 public:
  void reset() {
    firmware_.~Firmware();
    new (&firmware_) Firmware();
    started_ = now_;
    incoming_.clear();
    outgoing_.clear();
    sent_.clear();
    next_byte_in_ = next_byte_out_ = pulse_end_ = kNever;
    edge(1);  // when a board starts, its pins are inputs, pulled up
    period_end_ = next_loop_ = now_ + kStartTicks;
  }

  void receive(const uint8_t* bytes, size_t count) {
    const size_t fits = std::min(count, kMostBytes - incoming_.size());
    if (incoming_.empty() && fits > 0) next_byte_in_ = std::max(now_ + kByteTicks, line_free_);
    incoming_.insert(incoming_.end(), bytes, bytes + fits);
  }

  template <class T>
  static size_t take(std::deque<T>& from, T* to, size_t most) {
    const size_t count = std::min(most, from.size());
    std::copy_n(from.begin(), count, to);
    from.erase(from.begin(), from.begin() + static_cast<std::ptrdiff_t>(count));
    return count;
  }

  void advance(uint64_t until) {
    for (;;) {
      const uint64_t next = std::min({pulse_end_, period_end_, next_byte_in_, next_byte_out_, next_loop_});
      if (next > until) break;
      now_ = next;
      if (next == period_end_) {
        begin_period(next);
      } else if (next == pulse_end_) {
        edge(!Configuration::kPulseHigh);
        pulse_end_ = kNever;
      } else if (next == next_byte_in_) {
        const uint8_t byte = incoming_.front();
        incoming_.pop_front();
        line_free_ = next + kByteTicks;
        next_byte_in_ = incoming_.empty() ? kNever : line_free_;
        const uint32_t before = firmware_.accepted();
        firmware_.receive(byte, now_ms());
        if (firmware_.accepted() != before) accepted_ = next;
        loop();
      } else if (next == next_byte_out_) {
        sent_.push_back(outgoing_.front());
        outgoing_.pop_front();
        if (sent_.size() > kMostBytes) sent_.pop_front();
        next_byte_out_ = outgoing_.empty() ? kNever : next + kByteTicks;
      } else {
        loop();
      }
    }
    now_ = std::max(now_, until);
  }

  std::deque<uint8_t>& sent() { return sent_; }
  std::deque<dueppm_edge>& edges() { return edges_; }
  uint64_t accepted() const { return accepted_; }

 private:
  using Firmware = dueppm::Firmware<Configuration>;
  static constexpr uint64_t kNever = ~uint64_t{0};

  uint32_t now_ms() const { return static_cast<uint32_t>((now_ - started_) / (1000 * kTicksPerUs)); }

  void begin_period(uint64_t at) {
    edge(Configuration::kPulseHigh);
    pulse_end_ = at + Configuration::kPulseUs * kTicksPerUs;
    period_end_ = at + firmware_.next_period(0);
  }

  void edge(int level) {
    if (level == level_) return;
    level_ = level;
    edges_.push_back({now_, level});
    if (edges_.size() > kMostEdges) edges_.pop_front();
  }

  void loop() {
    firmware_.poll(now_ms());
    uint8_t bytes[64];
    while (outgoing_.size() < 128) {  // size of the board's buffer
      const size_t count = firmware_.send(bytes, std::min<size_t>(sizeof bytes, 128 - outgoing_.size()));
      if (count == 0) break;
      if (outgoing_.empty()) next_byte_out_ = now_ + kByteTicks;
      outgoing_.insert(outgoing_.end(), bytes, bytes + count);
    }
    next_loop_ = now_ + kLoopTicks;
  }

  Firmware firmware_;
  int level_ = -1;
  uint64_t now_ = 0;
  uint64_t started_ = 0;
  uint64_t period_end_ = kNever;
  uint64_t pulse_end_ = kNever;
  uint64_t next_byte_in_ = kNever;
  uint64_t next_byte_out_ = kNever;
  uint64_t next_loop_ = 0;
  uint64_t accepted_ = 0;
  uint64_t line_free_ = 0;  // when the next incoming byte may be complete
  std::deque<uint8_t> incoming_;
  std::deque<uint8_t> outgoing_;
  std::deque<uint8_t> sent_;
  std::deque<dueppm_edge> edges_;
};

Board& of(void* board) {
  return *static_cast<Board*>(board);
}

}  // namespace

extern "C" {

void* dueppm_new(void) {
  Board* board = new (std::nothrow) Board;
  if (board != nullptr) board->reset();
  return board;
}

void dueppm_free(void* board) {
  delete static_cast<Board*>(board);
}

void dueppm_reset(void* board) {
  of(board).reset();
}

void dueppm_receive(void* board, const uint8_t* bytes, size_t count) {
  of(board).receive(bytes, count);
}

size_t dueppm_send(void* board, uint8_t* bytes, size_t most) {
  return Board::take(of(board).sent(), bytes, most);
}

void dueppm_advance(void* board, uint64_t time_us) {
  of(board).advance(time_us * kTicksPerUs);
}

uint64_t dueppm_accepted(void* board) {
  return of(board).accepted();
}

size_t dueppm_edges(void* board, struct dueppm_edge* edges, size_t most) {
  return Board::take(of(board).edges(), edges, most);
}
}
