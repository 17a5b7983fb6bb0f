// A client of a Cortex host: finds the host, asks for the settings needed to read its frames, receives the
// frames, and reconnects after the host was away. No ROS.
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
#include "cortex_ros/sources/mocap_source.hpp"

namespace cortex_ros {

enum class Mode {
  kAuto,    // the stream; polling while no stream arrives
  kStream,  // the stream only (polling if the stream's port cannot be bound at all)
  kPoll,    // polling only; no stream socket is opened
};

Mode mode_from_text(const std::string& text);  // "auto", "stream", "poll"; else throws std::invalid_argument

// ClientOptions::host from the text that a user gives: "broadcast" becomes an empty host (search every
// network of this computer); an empty text throws std::invalid_argument, because nothing is sent to computers
// that the user has not named.
std::string host_from_text(const std::string& text);

struct ClientOptions {
  std::string host;           // dotted quad or name; empty: the first that answers the broadcast
  std::string local_address;  // own address on the network of the host; empty: the kernel's choice
  std::uint16_t command_port = 1510;
  std::string stream_group = "225.1.1.1";  // empty: join no group, take a unicast stream only
  std::uint16_t stream_port = 1001;
  Mode mode = Mode::kAuto;
  bool live_on_start = true;     // send LiveMode whenever the host was found (again)
  bool pause_on_exit = false;    // send Pause at the end of run(); stops the stream for other clients too
  double frame_rate_hz = 200.0;  // for polling, when the host does not report its own; 1 to 10000

  Time hello_interval = std::chrono::milliseconds(100);  // while searching; doubles up to ...
  Time hello_interval_max = std::chrono::seconds(1);
  Time search_patience = std::chrono::milliseconds(1500);  // search time before the host is reported as down
  Time request_timeout = std::chrono::milliseconds(250);
  int request_tries = 3;
  Time stream_timeout = std::chrono::milliseconds(500);  // no stream for this long: poll (kAuto)
  Time poll_timeout = std::chrono::milliseconds(100);
  Time probe_interval = std::chrono::milliseconds(250);  // between hellos to a host that has gone quiet
  Time host_timeout = std::chrono::seconds(1);           // silence after which the host counts as gone
};

constexpr double kMetresPerMillimetre = 0.001;

// The only place where host units are converted to metres. Overwrites number, delay, bodies and unidentified
// markers. Keeps the host's axes. Multiplies in double precision: 1000.5 mm is 1.0005 m (the original release
// multiplied in single precision and published 1.0005000829696655).
void to_mocap_frame(const FrameOfData& frame, double metres_per_unit, MocapFrame& out);

class Client : public MocapSource {
 public:
  // Throws std::invalid_argument for a bad option. Network problems, such as a host name that does not
  // resolve or a local address that the network card does not have yet, are reported and retried while
  // searching.
  // `events` and `clock` must outlive the client.
  Client(ClientOptions options, SourceEvents& events, const Clock& clock);

  void run() override;
  void stop() noexcept override { stop_ = true; }  // ends run() within 50 ms
  SourceStatus status() const override;

  // One iteration of run(): handles received datagrams, does what is due, then waits for the next event, at
  // most max_wait.
  void step(Time max_wait);

 private:
  enum class Phase {
    kSearching,
    kFirstSetUp,  // frames cannot be read: the host's unit is not known
    kRunning,     // frames are passed on, also while the host's settings are read again
  };
  enum class Channel { kCommand, kStream };

  // Receiving.
  void receive(UdpSocket& socket, Channel channel);
  void handle(const Datagram& datagram, Channel channel);
  bool is_from_host(const Endpoint& source, Channel channel) const;
  void refuse(const Datagram& datagram, Channel channel);
  void hear_all();
  void hint_at_other_host(const Packet& packet, const Endpoint& source, Channel channel);
  void hint_once(const Endpoint& about, const std::string& hint);
  void dispatch(const Packet& packet, const Datagram& datagram, Channel channel);
  void dispatch_while_searching(const Packet& packet, const Datagram& datagram, Channel channel);
  void handle_frame(const FrameOfData& frame, const Datagram& datagram, Channel channel);
  void handle_announcement(const Identity& identity);

  // The life of a connection.
  bool discovering() const { return options_.host.empty(); }
  void search(Time now);
  bool ready_to_search();
  void send_hello(Time now);
  void connect(const Endpoint& host, const Identity& identity);
  void begin_setup();
  void ask(const std::string& text, std::function<void(const GeneralReply&)> learn);
  void start_running();
  void report_up();
  void report_down(const std::string& why);
  void lose_host();
  void open_stream_socket();
  void join_group();

  // What is due.
  void tick();
  void choose_feed(Time now);
  void poll_if_due(Time now);
  double frame_rate_hz() const { return info_.frame_rate_hz.value_or(options_.frame_rate_hz); }
  void flush(Time now);
  Time time_to_next_event(Time now) const;
  void wait(Time time);
  void pause_host();

  void report_once(const std::string& problem);
  void set_host_text(const std::string& text, const std::string& obstacle = "");
  std::string target() const;

  const ClientOptions options_;
  SourceEvents& events_;
  const Clock& clock_;
  std::atomic<bool> stop_{false};

  Address local_;                           // set together with command_
  std::optional<Address> configured_host_;  // empty while discovering, and until its name resolves
  std::optional<UdpSocket> command_;        // empty only while searching, until it can be bound
  std::optional<UdpSocket> stream_;

  // What the host reported about itself. Empty: no answer, or no sensible one.
  struct HostInfo {
    Identity identity;
    std::optional<double> millimetres_per_unit;
    std::optional<int> up_axis;  // 0 x, 1 y, 2 z
    std::optional<double> frame_rate_hz;
    std::size_t bodies = 0;  // number of bodies that it defines
    bool live_mode_accepted = false;
  };

  Phase phase_ = Phase::kSearching;
  std::optional<Endpoint> host_;                         // known unless searching
  std::optional<boost::asio::ip::address> set_up_host_;  // the host that info_ describes, once it is complete
  HostInfo info_;
  bool setting_up_ = false;  // the requests of a set-up are in progress, in any phase
  RequestQueue requests_;
  bool down_reported_ = false;
  std::set<std::string> reported_;
  std::set<boost::asio::ip::address> hinted_;   // senders about which a hint was logged
  std::set<boost::asio::ip::address> refused_;  // other senders that were logged as refused
  int strange_[2] = {};                         // datagrams from other senders since hear_all(), by channel

  Time search_began_;
  Time hello_interval_;
  Time next_hello_;
  Time last_heard_{0};
  Time next_probe_{0};
  Time found_at_{0};
  Time last_setup_{0};
  Time last_stream_frame_{0};
  Time next_poll_{0};
  std::optional<Time> polled_at_;  // of the poll not answered yet; polls do not go through requests_
  int polls_without_news_ = 0;
  std::optional<std::int32_t> newest_;  // frame number
  MocapFrame frame_;

  // Reported by status(), from any thread.
  using Count = std::atomic<std::uint64_t>;
  Count early_{0};         // frames dropped because the host's unit was not known yet
  Count malformed_{0};     // packets from the host that could not be decoded
  Count faulty_items_{0};  // optional parts dropped from good frames
  Count foreign_{0};       // datagrams that did not come from the host
  Count stale_{0};         // answers that match no open request
  Count poll_timeouts_{0};
  Count connects_{0};       // times that the host was found
  Count announcements_{0};  // times that it announced itself while connected
  std::atomic<bool> up_{false};
  std::atomic<bool> polling_{false};  // frames are polled, not streamed
  mutable std::mutex text_mutex_;
  std::string host_text_;  // address:port, or what is being searched for
  std::string obstacle_;   // why the search cannot begin; empty: it can
};

}  // namespace cortex_ros
