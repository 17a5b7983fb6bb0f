// A client of a Cortex host: finds it, asks for what is needed to read its frames, receives them, and finds
// it again when it was away. No ROS.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <mutex>
#include <optional>
#include <set>
#include <string>

#include "cortex_ros/clock.hpp"
#include "cortex_ros/net.hpp"
#include "cortex_ros/protocol.hpp"
#include "cortex_ros/request_queue.hpp"

namespace cortex_ros {

enum class Mode {
  kAuto,    // the stream; polling while no stream comes
  kStream,  // the stream only (polling if the stream's port cannot be bound at all)
  kPoll,    // polling only; no stream socket is opened
};

Mode mode_from_text(const std::string& text);  // "auto", "stream", "poll"; else throws std::invalid_argument

// What a user writes for ClientOptions::host: "broadcast" asks every network of this computer (an empty
// host); empty throws std::invalid_argument, since nothing is sent to computers that the user has not named.
std::string host_from_text(const std::string& text);

// How frames come.
enum class Feed { kStream, kPoll };

struct ClientOptions {
  std::string host;           // dotted quad or name; empty: the first that answers the broadcast
  std::string local_address;  // own address on the network of the host; empty: the kernel's choice
  std::uint16_t command_port = 1510;
  std::string stream_group = "225.1.1.1";  // empty: join no group, take a unicast stream only
  std::uint16_t stream_port = 1001;
  Mode mode = Mode::kAuto;
  bool live_on_start = true;     // send LiveMode whenever the host was found (again)
  bool pause_on_exit = false;    // send Pause at the end of run(); stops the stream for other clients too
  double frame_rate_hz = 200.0;  // for polling, when the host does not tell its own; 1 to 10000
  Identity identity{"cortex_ros", {4, 1, 0, 0}};  // program id 4: a client library

  Time hello_interval = std::chrono::milliseconds(100);  // while searching; doubles up to ...
  Time hello_interval_max = std::chrono::seconds(1);
  Time search_patience = std::chrono::milliseconds(1500);  // then a host never seen is reported as down
  Time request_timeout = std::chrono::milliseconds(250);
  int request_tries = 3;
  Time stream_timeout = std::chrono::milliseconds(500);  // no stream for this long: poll (kAuto)
  Time poll_timeout = std::chrono::milliseconds(100);
  Time probe_interval = std::chrono::milliseconds(250);  // hello to a host that went quiet
  Time host_timeout = std::chrono::seconds(1);           // nothing at all from the host: it is gone
};

// What a host said about itself. Empty: it did not answer, or not sensibly.
struct HostInfo {
  Endpoint endpoint;
  Identity identity;
  std::optional<double> millimetres_per_unit;
  std::optional<int> up_axis;  // 0 x, 1 y, 2 z
  std::optional<double> frame_rate_hz;
  std::optional<std::size_t> bodies;  // that it defines
  bool live_mode_accepted = false;
};

struct ReceivedFrame {
  const FrameOfData& frame;
  Time receipt;  // wall time at which its datagram arrived
  Feed feed;
};

struct Statistics {
  bool host_up = false;
  std::string host;  // address:port, or what is being searched for
  Feed feed = Feed::kStream;
  std::uint64_t early = 0;         // frames dropped because the host's unit was not known yet
  std::uint64_t malformed = 0;     // packets of the host that could not be decoded
  std::uint64_t faulty_items = 0;  // optional parts dropped from good frames
  std::uint64_t foreign = 0;       // datagrams that did not come from the host
  std::uint64_t stale = 0;         // answers to no open request
  std::uint64_t poll_timeouts = 0;
  std::uint64_t connects = 0;       // times that the host was found
  std::uint64_t announcements = 0;  // times that it announced itself although it was there
  std::string obstacle;             // why the search cannot even begin; empty: it can
};

// All calls come from the thread that runs the client. References are good during the call only.
class ClientEvents {
 public:
  virtual ~ClientEvents() = default;
  // Every frame of the host, as it came: late ones and duplicates, too (see frame_sequence.hpp). Only a poll
  // that finds the frame of the poll before is not one.
  virtual void on_frame(const ReceivedFrame& frame) = 0;
  // Frames follow. Comes again, without an on_host_down() before, when the host was asked again because it
  // had announced itself; frames went on meanwhile, by what was known.
  virtual void on_host_up(const HostInfo&) {}
  virtual void on_host_down(const std::string& /*why*/) {}   // once per absence
  virtual void on_feed(Feed) {}                              // changed while the host is up
  virtual void on_comment(const std::string& /*text*/) {}    // text from the host
  virtual void on_malformed(const std::string& /*what*/) {}  // a packet, or part of a frame, was refused
  virtual void on_problem(const std::string& /*text*/) {}    // something for the user to fix; each text once
};

class Client {
 public:
  // Throws std::invalid_argument for a bad option. What the network does not give, such as a name that does
  // not resolve or an own address that the card does not have yet, is reported as a problem and tried again
  // while searching. `events` and `clock` must outlive the client.
  Client(ClientOptions options, ClientEvents& events, const Clock& clock);

  // Works until stop(). One thread at a time may be in run() or step().
  void run();

  // One turn: handles what has arrived, does what is due, then waits for the next event, at most max_wait.
  void step(Time max_wait);

  // Ends run() within 50 ms. May be called from any thread and from a signal handler.
  void stop() noexcept { stop_ = true; }

  Statistics statistics() const;  // from any thread

 private:
  enum class Phase {
    kSearching,
    kFirstSetUp,  // frames cannot be read: the host's unit is not known
    kRunning,     // frames are handed on, also while the host is asked again
  };
  enum class Channel { kCommand, kStream };

  // Receiving.
  void receive(UdpSocket& socket, Channel channel);
  void handle(const Datagram& datagram, Channel channel);
  bool is_from_host(const Endpoint& source, Channel channel) const;
  void hint_at_other_host(const Packet& packet, const Endpoint& source, Channel channel);
  void hint_once(const Endpoint& about, const std::string& hint);
  void dispatch(const Packet& packet, const Datagram& datagram, Channel channel);
  void dispatch_while_searching(const Packet& packet, const Datagram& datagram, Channel channel);
  void handle_answer_to_hello(const Identity& identity, const Endpoint& source);
  void handle_frame(const FrameOfData& frame, const Datagram& datagram, Channel channel);
  void handle_announcement(const Identity& identity);

  // The life of a connection.
  bool discovering() const { return options_.host.empty(); }
  void search(Time now);
  bool ready_to_search();
  void send_hello(Time now);
  void connect(const Endpoint& host, const Identity& identity);
  void begin_setup();
  void finish_setup();
  void start_running();
  void lose_host();
  void ask(const std::string& text, std::function<void(const GeneralReply*)> done);
  void open_stream_socket();
  void join_group();

  // What is due.
  void tick();
  void watch_host(Time now);
  void choose_feed(Time now);
  void poll_if_due(Time now);
  Time poll_period() const;
  void flush(RequestQueue& requests, Time now);
  Time time_to_next_event(Time now) const;
  void wait(Time time);
  void pause_host();

  void report_once(const std::string& problem);
  std::string target() const;
  template <typename Change>
  void update_statistics(Change change);

  const ClientOptions options_;
  ClientEvents& events_;
  const Clock& clock_;
  std::atomic<bool> stop_{false};

  Address local_;                           // set together with command_
  std::optional<Address> configured_host_;  // empty while discovering, and until its name resolves
  std::optional<UdpSocket> command_;        // there unless searching; empty until it can be bound
  std::optional<UdpSocket> stream_;

  Phase phase_ = Phase::kSearching;
  std::optional<Endpoint> host_;                         // known unless searching
  std::optional<boost::asio::ip::address> set_up_host_;  // the host that info_ tells of, once it is complete
  HostInfo info_;
  bool setting_up_ = false;  // the questions of a set-up are under way, whatever the phase
  RequestQueue requests_;
  bool down_reported_ = false;
  std::set<std::string> reported_;
  std::set<boost::asio::ip::address> hinted_;  // that a hint was given about

  Time search_began_;
  Time hello_interval_;
  Time next_hello_;
  Time last_heard_{0};
  Time next_probe_{0};
  Time found_at_{0};
  Time last_setup_{0};
  Time last_stream_frame_{0};
  Feed feed_ = Feed::kStream;
  Time next_poll_{0};
  std::optional<Time> polled_at_;  // and not answered yet; frames do not wait for answers to questions
  int polls_without_news_ = 0;
  std::optional<std::int32_t> newest_;  // frame number

  mutable std::mutex statistics_mutex_;
  Statistics statistics_;
};

}  // namespace cortex_ros
