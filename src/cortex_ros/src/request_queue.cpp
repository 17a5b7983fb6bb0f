#include "cortex_ros/request_queue.hpp"

#include <utility>

namespace cortex_ros {
namespace {

constexpr Time kSettle = std::chrono::milliseconds(20);  // for duplicates, between requests of one kind

bool answers(RequestQueue::Kind kind, const Packet& packet) {
  // A host that does not know the packet code of a request answers with this, whatever the request was.
  if (std::holds_alternative<UnrecognizedCommand>(packet)) {
    return true;
  }
  return kind == RequestQueue::Kind::kBodyDefs ? std::holds_alternative<BodyDefs>(packet)
                                               : std::holds_alternative<GeneralReply>(packet) ||
                                                     std::holds_alternative<UnrecognizedRequest>(packet);
}

}  // namespace

void RequestQueue::finish(const Packet* answer, Time now) {
  const Request request = std::move(*active_);
  active_.reset();
  // The first answer belongs to the first try; answers to the repeats follow at the intervals of sending.
  const Time stragglers = answer != nullptr ? last_sent_ - first_sent_ : timeout_;
  quiet_until(request.kind) = now + stragglers + kSettle;
  if (request.done) {
    request.done(answer);
  }
}

std::optional<Bytes> RequestQueue::send(Time now) {
  --active_->tries_left;
  last_sent_ = now;
  return active_->bytes;
}

std::optional<Bytes> RequestQueue::update(Time now) {
  if (active_ && now >= last_sent_ + timeout_) {
    if (active_->tries_left > 0) {
      return send(now);
    }
    finish(nullptr, now);
  }
  if (active_ || waiting_.empty() || now < quiet_until(waiting_.front().kind)) {
    return std::nullopt;
  }
  active_ = std::move(waiting_.front());
  waiting_.pop_front();
  first_sent_ = now;
  return send(now);
}

bool RequestQueue::offer(const Packet& packet, Time now) {
  if (!active_ || !answers(active_->kind, packet)) {
    return false;
  }
  finish(&packet, now);
  return true;
}

std::optional<Time> RequestQueue::next_event() const {
  if (active_) {
    return last_sent_ + timeout_;
  }
  if (waiting_.empty()) {
    return std::nullopt;
  }
  return quiet_until_[static_cast<std::size_t>(waiting_.front().kind)];
}

void RequestQueue::clear() {
  waiting_.clear();
  if (active_) {
    quiet_until(active_->kind) = last_sent_ + timeout_;  // its answer may still come
    active_.reset();
  }
}

}  // namespace cortex_ros
