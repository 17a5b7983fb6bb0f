// Requests to the host, one at a time. Pure: takes the time and the received packets, returns what to send.
#pragma once

#include <deque>
#include <functional>
#include <optional>

#include "cortex_ros/clock.hpp"
#include "cortex_ros/protocol.hpp"

namespace cortex_ros {

// An answer on the wire does not name its request. It is matched as follows:
//  - only one request is active at a time, and an answer must be of a type that this request can have;
//  - before the next request of the same kind there is a pause in which answers are discarded: a short one
//    for duplicates, and a longer one when the request was repeated (each repeat gets its own answer, as late
//    as the first) or given up (its answer may still arrive).
class RequestQueue {
 public:
  enum class Kind { kText, kBodyDefs };
  // Called with the answer, or with nullptr when the tries are used up. May push further requests.
  using Done = std::function<void(const Packet* answer)>;

  // timeout: time without an answer after which a request is repeated or given up.
  RequestQueue(Time timeout, int tries) : timeout_(timeout), tries_(tries) {}

  void push(Kind kind, Bytes packet, Done done) {
    waiting_.push_back({kind, std::move(packet), tries_, std::move(done)});
  }

  // Gives up an overdue request, then returns the packet to send now, if any.
  std::optional<Bytes> update(Time now);

  // Handles an incoming packet; true when it was the answer to the active request.
  bool offer(const Packet& packet, Time now);

  // Time of the next update(), unless an answer arrives earlier; empty when idle.
  std::optional<Time> next_event() const;

  bool idle() const { return waiting_.empty() && !active_; }
  void clear();  // drops all requests without calling back

 private:
  struct Request {
    Kind kind;
    Bytes bytes;
    int tries_left;
    Done done;
  };
  Time& quiet_until(Kind kind) { return quiet_until_[static_cast<std::size_t>(kind)]; }
  void finish(const Packet* answer, Time now);
  std::optional<Bytes> send(Time now);

  Time timeout_;
  int tries_;
  std::deque<Request> waiting_;
  std::optional<Request> active_;
  Time first_sent_{0};
  Time last_sent_{0};
  Time quiet_until_[2] = {};  // no new request of this kind before
};

}  // namespace cortex_ros
