#include "cortex_ros/request_queue.hpp"

#include <string_view>
#include <utility>

namespace cortex_ros {

namespace {
// The one text request, alone or with an argument, that a frame answers instead of a general reply.
constexpr std::string_view kFrameRequest = "GetFrameOfData";
}  // namespace

void RequestQueue::push(const Question& question, int tries, Time timeout, Done done) {
  Kind kind = std::holds_alternative<RequestFrame>(question) ? Kind::kFrame : Kind::kBodyDefs;
  if (const auto* request = std::get_if<GeneralRequest>(&question)) {
    const bool frame = request->text.compare(0, kFrameRequest.size(), kFrameRequest) == 0;
    kind = frame ? Kind::kTextFrame : Kind::kText;
  }
  const Bytes bytes = std::visit([](const auto& request) { return encode(request); }, question);
  waiting_.push_back({kind, bytes, tries, timeout, std::move(done)});
}

bool RequestQueue::answers(Kind kind, const Packet& packet) {
  // A host that does not know the packet code says so with this one, whatever was asked.
  if (std::holds_alternative<UnrecognizedCommand>(packet)) {
    return true;
  }
  switch (kind) {
    case Kind::kText:
      return std::holds_alternative<GeneralReply>(packet) ||
             std::holds_alternative<UnrecognizedRequest>(packet);
    case Kind::kTextFrame:
      return std::holds_alternative<FrameOfData>(packet) ||
             std::holds_alternative<UnrecognizedRequest>(packet);
    case Kind::kBodyDefs:
      return std::holds_alternative<BodyDefs>(packet);
    case Kind::kFrame:
      return std::holds_alternative<FrameOfData>(packet);
  }
  return false;
}

Time RequestQueue::may_start_at(Kind kind) const {
  // A stale frame does no harm: its number tells its age. So polling need not wait.
  return kind == Kind::kFrame ? Time{0} : quiet_until_[static_cast<std::size_t>(kind)];
}

void RequestQueue::finish(const Packet* answer, Time now) {
  Request request = std::move(*active_);
  active_.reset();
  // The answer that came first is that to the first try; those to the repeats follow at their
  // pace.
  const Time stragglers = answer != nullptr ? last_sent_ - first_sent_ : request.timeout;
  quiet_until(request.kind) = now + stragglers + timing_.settle;
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
  if (active_ && now >= last_sent_ + active_->timeout) {
    if (active_->tries_left > 0) {
      return send(now);
    }
    finish(nullptr, now);
  }
  if (active_ || waiting_.empty() || now < may_start_at(waiting_.front().kind)) {
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
    return last_sent_ + active_->timeout;
  }
  if (waiting_.empty()) {
    return std::nullopt;
  }
  return may_start_at(waiting_.front().kind);
}

void RequestQueue::clear() {
  waiting_.clear();
  if (active_) {
    quiet_until(active_->kind) = last_sent_ + active_->timeout;  // its answer may still come
    active_.reset();
  }
}

}  // namespace cortex_ros
