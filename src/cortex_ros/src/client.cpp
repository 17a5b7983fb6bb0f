#include "cortex_ros/client.hpp"

#include <poll.h>

#include <algorithm>
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>
#include <utility>

namespace cortex_ros {
namespace {

constexpr int kMaxDatagramsPerTurn = 64;  // so that a flood does not block the timers
constexpr Time kMaxWait = std::chrono::milliseconds(50);
constexpr Time kRestartHoldOff = std::chrono::seconds(1);  // between two set-ups caused by announcements
constexpr Time kPauseTimeout = std::chrono::milliseconds(100);
constexpr int kPauseTries = 2;
constexpr int kQuietPolls = 20;  // this many polls without a new frame: the host is paused
constexpr double kQuietPollRateHz = 10.0;
constexpr int kMaxStrange = 64;  // datagrams from other senders that are read before the kernel drops them
constexpr std::size_t kMaxReports =
    16;  // of each kind: packets from other computers must not fill log and memory
constexpr double kMinFrameRateHz = 1.0;
constexpr double kMaxFrameRateHz = 10000.0;
constexpr double kMinMillimetresPerUnit = 1e-3;        // a micrometre
constexpr double kMaxMillimetresPerUnit = 1e6;         // a kilometre
const Identity kIdentity{"cortex_ros", {4, 1, 0, 0}};  // program id 4: a client library

// Replaces `known` by `told` if that lies in [least, most], which a NaN does not.
void learn_within(std::optional<double>& known, std::optional<float> told, double least, double most) {
  if (told && *told >= least && *told <= most) {
    known = *told;
  }
}

std::vector<Position> to_positions(const std::vector<Marker>& markers, double metres_per_unit) {
  constexpr double kMissing = std::numeric_limits<double>::quiet_NaN();
  std::vector<Position> positions;
  positions.reserve(markers.size());
  for (const Marker& marker : markers) {
    if (marker.missing()) {
      positions.push_back({kMissing, kMissing, kMissing});
    } else {
      positions.push_back({double{marker.x} * metres_per_unit, double{marker.y} * metres_per_unit,
                           double{marker.z} * metres_per_unit});
    }
  }
  return positions;
}

}  // namespace

Mode mode_from_text(const std::string& text) {
  static const std::map<std::string, Mode> kModes = {
      {"auto", Mode::kAuto}, {"stream", Mode::kStream}, {"poll", Mode::kPoll}};
  const auto found = kModes.find(text);
  if (found == kModes.end()) {
    throw std::invalid_argument("mode must be auto, stream or poll, not '" + text + "'");
  }
  return found->second;
}

std::string host_from_text(const std::string& text) {
  if (text.empty()) {
    throw std::invalid_argument(
        "host is missing: set it to the Cortex computer's address or name, or to broadcast to search all "
        "networks");
  }
  return text == "broadcast" ? "" : text;
}

void to_mocap_frame(const FrameOfData& frame, double metres_per_unit, MocapFrame& out) {
  out.number = frame.frame;
  out.delay_s = frame.delay_s;
  out.bodies.resize(frame.bodies.size());
  for (std::size_t i = 0; i < frame.bodies.size(); ++i) {
    out.bodies[i].name = frame.bodies[i].name;
    out.bodies[i].markers = to_positions(frame.bodies[i].markers, metres_per_unit);
  }
  out.unidentified = to_positions(frame.unidentified, metres_per_unit);
}

Client::Client(ClientOptions options, SourceEvents& events, const Clock& clock)
    : options_(std::move(options)),
      events_(events),
      clock_(clock),
      requests_(options_.request_timeout, options_.request_tries),
      search_began_(clock.monotonic()),
      hello_interval_(options_.hello_interval),
      next_hello_(search_began_),
      host_text_(target()) {
  boost::system::error_code error;
  if (!options_.stream_group.empty() &&
      !boost::asio::ip::make_address_v4(options_.stream_group, error).is_multicast()) {
    throw std::invalid_argument("stream group " + options_.stream_group +
                                " is not a multicast address (224.0.0.0/4)");
  }
  if (!(options_.frame_rate_hz >= kMinFrameRateHz && options_.frame_rate_hz <= kMaxFrameRateHz)) {
    throw std::invalid_argument("frame rate must be from 1 to 10000 Hz, not " +
                                std::to_string(options_.frame_rate_hz));
  }
}

void Client::run() {
  while (!stop_) {
    step(kMaxWait);
  }
  if (options_.pause_on_exit && host_) {
    pause_host();
  }
}

void Client::step(Time max_wait) {
  // Received datagrams are read before anything is sent, so that an answer that has already arrived is not
  // matched to a later request.
  if (command_) {
    receive(*command_, Channel::kCommand);
  }
  if (stream_) {
    receive(*stream_, Channel::kStream);
  }
  tick();
  wait(std::min(max_wait, time_to_next_event(clock_.monotonic())));
}

SourceStatus Client::status() const {
  SourceStatus status;
  status.up = up_;
  status.mode = polling_ ? "poll" : "stream";
  if (polling_ && options_.mode != Mode::kPoll) {
    status.warnings.emplace_back("no stream, polling");
  }
  status.counters = {{"before the unit was known", early_},
                     {"malformed", malformed_, "malformed packets"},
                     {"faulty optional parts", faulty_items_, "malformed packets"},
                     {"foreign datagrams", foreign_},
                     {"stale answers", stale_},
                     {"poll time-outs", poll_timeouts_},
                     {"times found", connects_},
                     {"announcements of the host", announcements_, "the host announced itself again"}};
  const std::lock_guard<std::mutex> lock(text_mutex_);
  status.host = host_text_;
  status.why_down = obstacle_.empty() ? "no answer from " + host_text_ : obstacle_;
  return status;
}

void Client::set_host_text(const std::string& text, const std::string& obstacle) {
  const std::lock_guard<std::mutex> lock(text_mutex_);
  host_text_ = text;
  obstacle_ = obstacle;
}

// ---- receiving

void Client::receive(UdpSocket& socket, Channel channel) {
  Datagram datagram;
  for (int i = 0; i < kMaxDatagramsPerTurn && socket.receive(datagram); ++i) {
    handle(datagram, channel);
  }
}

bool Client::is_from_host(const Endpoint& source, Channel channel) const {
  if (host_) {
    // The stream may come from any port of the host, answers come from the port that we ask.
    return channel == Channel::kStream ? source.address() == host_->address() : source == *host_;
  }
  // While searching: the host may answer from another port than the one we called; that port is remembered.
  if (discovering()) {
    return channel == Channel::kCommand;
  }
  return configured_host_ && source.address() == *configured_host_;
}

void Client::handle(const Datagram& datagram, Channel channel) {
  if (!is_from_host(datagram.source, channel)) {
    refuse(datagram, channel);
    return;
  }
  last_heard_ = clock_.monotonic();
  std::optional<Packet> packet;
  try {
    if (datagram.truncated) {
      throw ProtocolError("datagram longer than " + std::to_string(datagram.size) + " bytes was truncated");
    }
    packet = decode(datagram.data, datagram.size);
  } catch (const ProtocolError& error) {
    ++malformed_;
    events_.on_frequent_log(LogLevel::kWarning,
                            std::string("malformed packet from the Cortex host: ") + error.what());
    return;
  }
  if (host_) {
    dispatch(*packet, datagram, channel);
  } else {
    dispatch_while_searching(*packet, datagram, channel);
  }
}

// Other senders are named once in the log. When they send much, the kernel drops their datagrams, so that
// these do not take the buffer space of the host's.
void Client::refuse(const Datagram& datagram, Channel channel) {
  ++foreign_;
  const boost::asio::ip::address address = datagram.source.address();
  const std::optional<Address> host = host_ ? std::optional(host_->address().to_v4()) : configured_host_;
  if (host && address != *host && refused_.size() < kMaxReports && refused_.insert(address).second) {
    events_.on_log(LogLevel::kWarning, "datagrams from " + address.to_string() +
                                           " are refused: the Cortex host is " + host->to_string() +
                                           " (said once, then counted as foreign datagrams)");
  }
  if (channel == Channel::kCommand) {
    try {
      hint_at_other_host(decode(datagram.data, datagram.size), datagram.source, channel);
    } catch (const ProtocolError&) {  // counted as foreign
    }
  }
  if (host && ++strange_[static_cast<std::size_t>(channel)] == kMaxStrange) {
    (channel == Channel::kCommand ? *command_ : *stream_).hear_only(*host);
  }
}

// Call this when the host changes.
void Client::hear_all() {
  for (std::optional<UdpSocket>* socket : {&command_, &stream_}) {
    if (*socket) {
      (*socket)->hear_all();
    }
  }
  strange_[0] = strange_[1] = 0;
}

// An answer from another address reveals two mistakes: a host with two interfaces that answers from the one
// that we did not call, and a second host on the network although we took the one that answered first.
void Client::hint_at_other_host(const Packet& packet, const Endpoint& source, Channel channel) {
  const auto* here = std::get_if<HereIAm>(&packet);
  if (channel != Channel::kCommand || here == nullptr) {
    return;
  }
  if (!discovering() && !host_) {
    hint_once(source, "a Cortex host answers from " + to_string(source) + ", not from the configured host " +
                          target() + ": set the parameter 'host' to " + source.address().to_string());
  } else if (discovering() && host_ && clock_.monotonic() - found_at_ <= options_.search_patience &&
             here->identity.version[0] == kCortexProgramId && source.address() != host_->address()) {
    hint_once(source, "more than one Cortex host, or one with two addresses, answers the search: " +
                          to_string(*host_) + " was first and is used, " + to_string(source) +
                          " is not: set the parameter 'host' to the right one");
  }
}

void Client::dispatch_while_searching(const Packet& packet, const Datagram& datagram, Channel channel) {
  const auto* here = std::get_if<HereIAm>(&packet);
  if (channel == Channel::kCommand) {
    if (here == nullptr) {
      return;
    }
    // Other programs use the protocol, too. A host that the user has named may be any of them.
    if (discovering() && here->identity.version[0] != kCortexProgramId) {
      ++foreign_;
      hint_once(datagram.source, "program '" + here->identity.name + "' at " + to_string(datagram.source) +
                                     " answers the search but is not Cortex (program number " +
                                     std::to_string(here->identity.version[0]) +
                                     "): ignored. To use it, set the parameter 'host' to its address");
      return;
    }
    connect(datagram.source, here->identity);
  } else if (const auto* frame = std::get_if<FrameOfData>(&packet)) {
    // It streams already, so it is running; the set-up will show whether it answers.
    if (command_) {
      connect({datagram.source.address(), options_.command_port}, Identity());
    }
    handle_frame(*frame, datagram, channel);
  } else if (here != nullptr || std::holds_alternative<HelloWorld>(packet)) {
    next_hello_ = clock_.monotonic();
  }
}

void Client::dispatch(const Packet& packet, const Datagram& datagram, Channel channel) {
  bool answer = channel == Channel::kCommand && requests_.offer(packet, clock_.monotonic());
  const bool unrecognized = std::holds_alternative<UnrecognizedCommand>(packet);
  if (channel == Channel::kCommand && polled_at_ && !answer &&
      (unrecognized || std::holds_alternative<FrameOfData>(packet))) {
    polled_at_.reset();
    answer = true;
  }
  if (const auto* frame = std::get_if<FrameOfData>(&packet)) {
    handle_frame(*frame, datagram, channel);
  } else if (const auto* comment = std::get_if<Comment>(&packet)) {
    events_.on_frequent_log(LogLevel::kInfo, "Cortex says: " + comment->text);
  } else if (const auto* hello = std::get_if<HelloWorld>(&packet)) {
    handle_announcement(hello->identity);
  } else if (const auto* here = std::get_if<HereIAm>(&packet)) {
    if (channel == Channel::kStream) {
      handle_announcement(here->identity);
    }
  } else if (!answer) {
    ++stale_;
  }
}

// A host announces itself when it starts; it is then no longer in the live mode that was requested before. So
// its settings are read again. Anyone can forge such a packet: it must not cost a single frame, and the known
// settings stay valid until the host itself reports others.
void Client::handle_announcement(const Identity& identity) {
  if (identity.version[0] != kCortexProgramId) {
    return;
  }
  ++announcements_;
  if (phase_ == Phase::kRunning && !setting_up_ && !stop_ &&
      clock_.monotonic() - last_setup_ > kRestartHoldOff) {
    info_.identity = identity;
    begin_setup();
  }
}

// Passes on every frame of the host, including late ones and duplicates (see frame_sequence.hpp). Only a poll
// that returns the newest frame again is ignored.
void Client::handle_frame(const FrameOfData& frame, const Datagram& datagram, Channel channel) {
  if (channel == Channel::kStream) {
    last_stream_frame_ = clock_.monotonic();
  }
  if (stop_) {
    return;  // run() is about to end
  }
  if (phase_ != Phase::kRunning) {
    ++early_;
    return;
  }
  if (channel == Channel::kCommand && newest_ == frame.frame) {
    ++polls_without_news_;
    return;
  }
  polls_without_news_ = 0;
  newest_ = frame.frame;
  to_mocap_frame(frame, kMetresPerMillimetre * info_.millimetres_per_unit.value_or(1.0), frame_);
  frame_.receipt = datagram.kernel_time.value_or(clock_.wall());
  events_.on_frame(frame_);
  // After the frame: logging may be slow.
  if (!frame.faults.empty()) {
    faulty_items_ += frame.faults.size();
    events_.on_frequent_log(LogLevel::kWarning, "malformed packet from the Cortex host: frame " +
                                                    std::to_string(frame.frame) + ": " +
                                                    frame.faults.front());
  }
}

// ---- connection

std::string Client::target() const {
  return (discovering() ? "broadcast" : options_.host) + ":" + std::to_string(options_.command_port);
}

void Client::report_once(const std::string& problem) {
  if (reported_.size() < kMaxReports && reported_.insert(problem).second) {
    events_.on_log(LogLevel::kError, problem);
  }
}

// Senders are distinguished by address only: they can choose ports and texts freely.
void Client::hint_once(const Endpoint& about, const std::string& hint) {
  if (hinted_.size() < kMaxReports && hinted_.insert(about.address()).second) {
    events_.on_log(LogLevel::kError, hint);
  }
}

void Client::send_hello(Time now) {
  const Bytes hello = encode_hello(kIdentity);
  next_probe_ = now + options_.probe_interval;
  if (host_) {
    command_->send(hello, *host_);
  } else if (configured_host_) {
    command_->send(hello, {*configured_host_, options_.command_port});
  } else {
    for (const Address& address : broadcast_addresses(local_)) {
      command_->send(hello, {address, options_.command_port});
    }
  }
}

// Right after the computer was switched on the network may not be up yet, so failures are retried.
bool Client::ready_to_search() {
  open_stream_socket();
  std::string obstacle;
  try {
    if (!discovering() && !configured_host_) {
      configured_host_ = resolve(options_.host);
    }
    if (!command_) {
      local_ = options_.local_address.empty() ? Address() : resolve(options_.local_address);
      command_.emplace(Endpoint{local_, 0}, UdpSocket::Share::kNo);
    }
  } catch (const NetworkError& error) {
    obstacle = error.what();
    if (error.code() == boost::system::errc::address_not_available) {
      obstacle += ". To fix it, give this computer's network card that address, or correct 'local_address'";
    }
    report_once("cannot search for the Cortex host yet: " + obstacle);
  }
  set_host_text(target(), obstacle);
  return obstacle.empty();
}

void Client::search(Time now) {
  if (now >= next_hello_) {
    if (ready_to_search()) {
      send_hello(now);
    }
    next_hello_ = clock_.monotonic() + hello_interval_;  // resolving a name may have taken its time
    hello_interval_ = std::min(2 * hello_interval_, options_.hello_interval_max);
  }
  if (now - search_began_ >= options_.search_patience) {
    report_down(obstacle_.empty() ? "no answer from " + target()
                                  : "the search for " + target() + " cannot begin: " + obstacle_);
  }
}

// Once per absence.
void Client::report_down(const std::string& why) {
  if (down_reported_) {
    return;
  }
  down_reported_ = true;
  events_.on_host_down(why +
                       ". Check that Cortex runs, the cable and the network; that the parameters host, "
                       "local_address and command_port match Cortex' network settings; and that its firewall "
                       "lets UDP port " +
                       std::to_string(options_.command_port) + " through");
}

void Client::report_up() {
  MocapHost host;
  host.frame_rate_hz = frame_rate_hz();
  host.up_axis = "xyz"[info_.up_axis.value_or(2)];
  if (!info_.millimetres_per_unit) {
    host.remarks.emplace_back("the host does not report its length unit: millimetres are assumed");
  } else if (*info_.millimetres_per_unit != 1.0) {
    host.remarks.push_back("the host's length unit is " + std::to_string(*info_.millimetres_per_unit) +
                           " mm: converted to metres");
  }
  if (!info_.up_axis) {
    host.remarks.emplace_back("the host does not report its up axis: z is assumed");
  }
  if (!info_.frame_rate_hz) {
    host.remarks.push_back("the host does not report its frame rate: " + std::to_string(frame_rate_hz()) +
                           " Hz is assumed (parameter frame_rate)");
  }
  if (options_.live_on_start && !info_.live_mode_accepted) {
    host.remarks.emplace_back("the host did not accept LiveMode: start live mode in Cortex");
  }
  const auto& version = info_.identity.version;
  std::ostringstream text;
  text << to_string(*host_) << ", program '" << info_.identity.name << "' " << int{version[1]} << '.'
       << int{version[2]} << '.' << int{version[3]} << ", " << host.frame_rate_hz << " Hz, " << info_.bodies
       << " bodies defined";
  host.description = text.str();
  events_.on_host_up(host);
}

void Client::connect(const Endpoint& host, const Identity& identity) {
  hear_all();
  const bool known = set_up_host_ == host.address();
  if (!known) {
    set_up_host_.reset();
    info_ = HostInfo();
  }
  host_ = host;
  found_at_ = clock_.monotonic();
  info_.identity = identity;
  ++connects_;
  set_host_text(to_string(host));
  open_stream_socket();
  if (stream_ && !options_.stream_group.empty()) {
    join_group();
  }
  newest_.reset();
  requests_.clear();
  begin_setup();
  if (known) {
    start_running();  // its frames can be read by what is known, while they are read again
    report_up();
  } else {
    phase_ = Phase::kFirstSetUp;
  }
}

void Client::ask(const std::string& text, std::function<void(const GeneralReply&)> learn) {
  requests_.push(RequestQueue::Kind::kText, encode_text_request(text),
                 [learn = std::move(learn)](const Packet* answer) {
                   if (const auto* reply = answer == nullptr ? nullptr : std::get_if<GeneralReply>(answer)) {
                     learn(*reply);
                   }
                 });
}

// LiveMode comes last: by then everything that is needed to read the first frame is known. A missing or
// invalid answer changes nothing: a host that was in inches does not change to millimetres because it is
// silent.
void Client::begin_setup() {
  setting_up_ = true;
  last_setup_ = clock_.monotonic();
  ask("GetConversionToMillimeters", [this](const GeneralReply& reply) {
    learn_within(info_.millimetres_per_unit, as_float(reply), kMinMillimetresPerUnit, kMaxMillimetresPerUnit);
  });
  ask("GetUpAxis", [this](const GeneralReply& reply) {
    const std::optional<std::int32_t> axis = as_int(reply);
    info_.up_axis = axis && *axis >= 0 && *axis <= 2 ? axis : info_.up_axis;
  });
  ask("GetContextFrameRate", [this](const GeneralReply& reply) {
    learn_within(info_.frame_rate_hz, as_float(reply), kMinFrameRateHz, kMaxFrameRateHz);
  });
  requests_.push(RequestQueue::Kind::kBodyDefs, encode_request(Command::kRequestBodyDefs),
                 [this](const Packet* answer) {
                   if (const auto* defs = answer == nullptr ? nullptr : std::get_if<BodyDefs>(answer)) {
                     info_.bodies = defs->bodies;
                   }
                 });
  if (options_.live_on_start) {
    requests_.push(RequestQueue::Kind::kText, encode_text_request("LiveMode"), [this](const Packet* answer) {
      info_.live_mode_accepted = answer != nullptr && std::holds_alternative<GeneralReply>(*answer);
    });
  }
}

void Client::start_running() {
  const Time now = clock_.monotonic();
  phase_ = Phase::kRunning;
  down_reported_ = false;
  polls_without_news_ = 0;
  last_stream_frame_ = now;  // gives the stream stream_timeout to begin
  next_poll_ = now;
  polling_ = options_.mode == Mode::kPoll || !stream_;
  up_ = true;
}

void Client::lose_host() {
  const std::string name = to_string(*host_);
  host_.reset();
  hear_all();
  phase_ = Phase::kSearching;
  setting_up_ = false;
  requests_.clear();
  polled_at_.reset();
  search_began_ = next_hello_ = clock_.monotonic();
  hello_interval_ = options_.hello_interval;
  up_ = false;
  set_host_text(target());
  report_down("nothing heard from " + name + " for " + std::to_string(to_seconds(options_.host_timeout)) +
              " s");
}

void Client::open_stream_socket() {
  if (stream_ || options_.mode == Mode::kPoll) {
    return;
  }
  try {
    // Bound to the wildcard address, because some hosts send the stream by unicast.
    stream_.emplace(Endpoint{Address(), options_.stream_port}, UdpSocket::Share::kYes);
  } catch (const NetworkError& error) {
    const std::string fix =
        error.code() == boost::system::errc::permission_denied
            ? "configure a stream port above 1023 here and at the host, or grant the program "
              "CAP_NET_BIND_SERVICE "
              "(setcap cap_net_bind_service=+ep), or lower net.ipv4.ip_unprivileged_port_start"
            : "end the program that holds the port, or configure another stream port here and at the host";
    report_once(std::string("no stream, polling instead: ") + error.what() + ". To fix it, " + fix);
  }
}

void Client::join_group() {
  // Without a configured interface, take the one that leads to the host: the route for the group, which the
  // kernel would use, is often a different one or missing.
  try {
    const Address interface =
        local_.is_unspecified() ? source_address_towards(host_->address().to_v4()) : local_;
    stream_->join(boost::asio::ip::make_address_v4(options_.stream_group), interface);
  } catch (const NetworkError& error) {
    report_once(
        std::string("no multicast stream: ") + error.what() +
        ". To fix it, set the parameter 'local_address' to this computer's address on the host's network");
  }
}

// ---- what is due

void Client::tick() {
  const Time now = clock_.monotonic();
  for (std::optional<UdpSocket>* socket : {&command_, &stream_}) {
    foreign_ += *socket ? (*socket)->newly_refused() : 0;
  }
  if (phase_ == Phase::kSearching) {
    search(now);
    return;
  }
  const Time silence = now - last_heard_;
  if (silence >= options_.host_timeout) {
    lose_host();
    return;
  }
  if (silence >= options_.probe_interval && now >= next_probe_) {
    send_hello(now);
  }
  if (phase_ == Phase::kRunning) {
    choose_feed(now);
    poll_if_due(now);
  }
  flush(now);
  if (setting_up_ && requests_.idle()) {
    setting_up_ = false;
    set_up_host_ = host_->address();
    if (phase_ != Phase::kRunning) {
      start_running();
    }
    report_up();
  }
}

void Client::choose_feed(Time now) {
  const bool no_stream = now - last_stream_frame_ >= options_.stream_timeout;
  const bool poll = options_.mode == Mode::kPoll || !stream_ || (options_.mode == Mode::kAuto && no_stream);
  if (poll == polling_) {
    return;
  }
  polling_ = poll;
  next_poll_ = now;
  if (poll) {
    events_.on_log(LogLevel::kWarning, "no stream on " + options_.stream_group + ":" +
                                           std::to_string(options_.stream_port) +
                                           ": polling. Is Cortex in live mode, and do group, "
                                           "port and local_address match its settings?");
  } else {
    events_.on_log(LogLevel::kInfo, "the stream is back, polling ends");
  }
}

void Client::poll_if_due(Time now) {
  if (polled_at_ && now - *polled_at_ >= options_.poll_timeout) {
    polled_at_.reset();
    ++poll_timeouts_;
  }
  if (!polling_ || now < next_poll_ || polled_at_) {
    return;
  }
  // A paused host need not be asked 200 times a second.
  const double rate_hz = polls_without_news_ >= kQuietPolls ? kQuietPollRateHz : frame_rate_hz();
  const Time period = from_seconds(1.0 / rate_hz);
  next_poll_ += period;
  if (next_poll_ <= now) {
    next_poll_ = now + period;
  }
  polled_at_ = now;
  command_->send(encode_request(Command::kRequestFrame), *host_);
}

void Client::flush(Time now) {
  while (const std::optional<Bytes> packet = requests_.update(now)) {
    command_->send(*packet, *host_);
  }
}

Time Client::time_to_next_event(Time now) const {
  Time next = now + kMaxWait;
  if (phase_ == Phase::kSearching) {
    next = std::min(next, next_hello_);
  } else {
    next = std::min(next, requests_.next_event().value_or(next));
    if (polled_at_) {
      next = std::min(next, *polled_at_ + options_.poll_timeout);
    } else if (phase_ == Phase::kRunning && polling_) {
      next = std::min(next, next_poll_);
    }
  }
  return std::max(next - now, Time{0});
}

void Client::wait(Time time) {
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(time);
  const timespec timeout{static_cast<time_t>(seconds.count()), static_cast<long>((time - seconds).count())};
  // poll() skips an entry with a negative descriptor.
  pollfd waiting[] = {{command_ ? command_->fd() : -1, POLLIN, 0}, {stream_ ? stream_->fd() : -1, POLLIN, 0}};
  ppoll(waiting, std::size(waiting), &timeout, nullptr);
}

void Client::pause_host() {
  requests_ = RequestQueue(kPauseTimeout, kPauseTries);
  ask("Pause", [](const GeneralReply&) {});
  while (!requests_.idle()) {
    receive(*command_, Channel::kCommand);
    flush(clock_.monotonic());
    wait(std::chrono::milliseconds(10));
  }
}

}  // namespace cortex_ros
