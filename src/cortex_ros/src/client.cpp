#include "cortex_ros/client.hpp"

#include <poll.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace cortex_ros {
namespace {

constexpr int kMaxDatagramsPerTurn = 64;  // a flood must not keep the timers from running
constexpr Time kMaxWait = std::chrono::milliseconds(50);
constexpr Time kRestartHoldOff = std::chrono::seconds(1);  // between two set-ups that announcements provoke
constexpr Time kPauseTimeout = std::chrono::milliseconds(100);
constexpr int kPauseTries = 2;
constexpr int kQuietPolls = 20;  // this many polls without a new frame: the host is paused
constexpr Time kQuietPollPeriod = std::chrono::milliseconds(100);
constexpr std::size_t kMaxReports =
    16;  // of each kind: packets from other computers must not fill log and memory
constexpr double kMinFrameRateHz = 1.0;
constexpr double kMaxFrameRateHz = 10000.0;
constexpr double kMinMillimetresPerUnit = 1e-3;  // a micrometre
constexpr double kMaxMillimetresPerUnit = 1e6;   // a kilometre

// The number in a reply if it lies in [least, most]; a NaN does not.
std::optional<double> number_within(const GeneralReply* reply, double least, double most) {
  const std::optional<float> value = reply == nullptr ? std::nullopt : as_float(*reply);
  const double number = value ? static_cast<double>(*value) : 0.0;
  return value && number >= least && number <= most ? std::make_optional(number) : std::nullopt;
}

std::optional<int> axis_number(const GeneralReply* reply) {
  const std::optional<std::int32_t> value = reply == nullptr ? std::nullopt : as_int(*reply);
  return value && *value >= 0 && *value <= 2 ? std::make_optional(static_cast<int>(*value)) : std::nullopt;
}

}  // namespace

Mode mode_from_text(const std::string& text) {
  if (text == "auto") {
    return Mode::kAuto;
  }
  if (text == "stream") {
    return Mode::kStream;
  }
  if (text == "poll") {
    return Mode::kPoll;
  }
  throw std::invalid_argument("mode must be auto, stream or poll, not '" + text + "'");
}

std::string host_from_text(const std::string& text) {
  if (text.empty()) {
    throw std::invalid_argument(
        "host is missing: set it to the Cortex computer's address or name, or to broadcast to search all "
        "networks");
  }
  return text == "broadcast" ? "" : text;
}

Client::Client(ClientOptions options, ClientEvents& events, const Clock& clock)
    : options_(std::move(options)),
      events_(events),
      clock_(clock),
      requests_(options_.request_timeout, options_.request_tries),
      search_began_(clock.monotonic()),
      hello_interval_(options_.hello_interval),
      next_hello_(search_began_) {
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
  statistics_.host = target();
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
  // What has arrived is read before anything is sent: an answer on the way cannot be taken for one
  // to a later request.
  if (command_) {
    receive(*command_, Channel::kCommand);
  }
  if (stream_) {
    receive(*stream_, Channel::kStream);
  }
  tick();
  wait(std::min(max_wait, time_to_next_event(clock_.monotonic())));
}

Statistics Client::statistics() const {
  const std::lock_guard<std::mutex> lock(statistics_mutex_);
  return statistics_;
}

template <typename Change>
void Client::update_statistics(Change change) {
  const std::lock_guard<std::mutex> lock(statistics_mutex_);
  change(statistics_);
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
    // The stream comes from a port of the host's choice, answers come from the port that we ask.
    return channel == Channel::kStream ? source.address() == host_->address() : source == *host_;
  }
  // While searching: the host may answer from another port than the one we called, and is remembered with it.
  if (discovering()) {
    return channel == Channel::kCommand;
  }
  return configured_host_ && source.address() == *configured_host_;
}

void Client::handle(const Datagram& datagram, Channel channel) {
  std::optional<Packet> packet;
  std::string fault;
  try {
    if (datagram.truncated) {
      throw ProtocolError("datagram longer than " + std::to_string(datagram.size) + " bytes was truncated");
    }
    packet = decode(datagram.data, datagram.size);
  } catch (const ProtocolError& error) {
    fault = error.what();
  }
  if (!is_from_host(datagram.source, channel)) {
    update_statistics([](Statistics& s) { ++s.foreign; });
    if (packet) {
      hint_at_other_host(*packet, datagram.source, channel);
    }
    return;
  }
  last_heard_ = clock_.monotonic();
  if (!packet) {
    update_statistics([](Statistics& s) { ++s.malformed; });
    events_.on_malformed(fault);
  } else if (host_) {
    dispatch(*packet, datagram, channel);
  } else {
    dispatch_while_searching(*packet, datagram, channel);
  }
}

// Two mistakes that an answer from another address explains: a host with two interfaces that answers from the
// one that we did not call, and a second host on the network where we took whichever answered first.
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

void Client::handle_answer_to_hello(const Identity& identity, const Endpoint& source) {
  // Other programs speak the protocol, too. A host that the user has named may be any of them.
  if (discovering() && identity.version[0] != kCortexProgramId) {
    update_statistics([](Statistics& s) { ++s.foreign; });
    hint_once(source, "program '" + identity.name + "' at " + to_string(source) +
                          " answers the search but is not Cortex (program number " +
                          std::to_string(identity.version[0]) +
                          "): ignored. To use it, set the parameter 'host' to its address");
    return;
  }
  connect(source, identity);
}

void Client::dispatch_while_searching(const Packet& packet, const Datagram& datagram, Channel channel) {
  if (channel == Channel::kCommand) {
    if (const auto* here = std::get_if<HereIAm>(&packet)) {
      handle_answer_to_hello(here->identity, datagram.source);
    }
  } else if (const auto* frame = std::get_if<FrameOfData>(&packet)) {
    // It streams already, so it is there; whether it answers will be seen.
    if (command_) {
      connect({datagram.source.address(), options_.command_port}, Identity());
    }
    handle_frame(*frame, datagram, channel);
  } else if (std::holds_alternative<HereIAm>(packet) || std::holds_alternative<HelloWorld>(packet)) {
    next_hello_ = clock_.monotonic();
  }
}

void Client::dispatch(const Packet& packet, const Datagram& datagram, Channel channel) {
  const Time now = clock_.monotonic();
  bool answer = channel == Channel::kCommand && requests_.offer(packet, now);
  const bool unrecognized = std::holds_alternative<UnrecognizedCommand>(packet);
  if (channel == Channel::kCommand && polled_at_ && !answer &&
      (unrecognized || std::holds_alternative<FrameOfData>(packet))) {
    polled_at_.reset();
    answer = true;
  }
  if (const auto* frame = std::get_if<FrameOfData>(&packet)) {
    handle_frame(*frame, datagram, channel);
  } else if (const auto* comment = std::get_if<Comment>(&packet)) {
    events_.on_comment(comment->text);
  } else if (const auto* hello = std::get_if<HelloWorld>(&packet)) {
    handle_announcement(hello->identity);
  } else if (const auto* here = std::get_if<HereIAm>(&packet)) {
    if (channel == Channel::kStream) {
      handle_announcement(here->identity);
    }
  } else if (!answer) {
    update_statistics([](Statistics& s) { ++s.stale; });
  }
}

// A host that has just started says so; it knows nothing of the live mode that its predecessor was put into.
// So its settings are read again. Anyone can send such a packet in the host's name: it must not cost a single
// frame, and what was known stays known until the host itself says otherwise.
void Client::handle_announcement(const Identity& identity) {
  if (identity.version[0] != kCortexProgramId) {
    return;
  }
  update_statistics([](Statistics& s) { ++s.announcements; });
  if (phase_ == Phase::kRunning && !setting_up_ && !stop_ &&
      clock_.monotonic() - last_setup_ > kRestartHoldOff) {
    info_.identity = identity;
    begin_setup();
  }
}

void Client::handle_frame(const FrameOfData& frame, const Datagram& datagram, Channel channel) {
  const Feed feed = channel == Channel::kStream ? Feed::kStream : Feed::kPoll;
  if (feed == Feed::kStream) {
    last_stream_frame_ = clock_.monotonic();
  }
  if (stop_) {
    return;  // run() is about to end
  }
  if (phase_ != Phase::kRunning) {
    update_statistics([](Statistics& s) { ++s.early; });
    return;
  }
  if (feed == Feed::kPoll && newest_ == frame.frame) {
    ++polls_without_news_;
    return;
  }
  polls_without_news_ = 0;
  newest_ = frame.frame;
  events_.on_frame({frame, datagram.kernel_time.value_or(clock_.wall()), feed});
  // After the frame: logging may be slow.
  if (!frame.faults.empty()) {
    update_statistics([&](Statistics& s) { s.faulty_items += frame.faults.size(); });
    events_.on_malformed("frame " + std::to_string(frame.frame) + ": " + frame.faults.front());
  }
}

// ---- connection

std::string Client::target() const {
  const std::string port = ":" + std::to_string(options_.command_port);
  return (discovering() ? "broadcast" : options_.host) + port;
}

void Client::report_once(const std::string& problem) {
  if (reported_.size() < kMaxReports && reported_.insert(problem).second) {
    events_.on_problem(problem);
  }
}

// Only the address tells senders apart: ports and texts are theirs to choose.
void Client::hint_once(const Endpoint& about, const std::string& hint) {
  if (hinted_.size() < kMaxReports && hinted_.insert(about.address()).second) {
    events_.on_problem(hint);
  }
}

void Client::send_hello(Time now) {
  const Bytes hello = encode_hello(options_.identity);
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

// Right after the computer was switched on the network may not be there yet: no reason to give up.
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
  }
  update_statistics([&](Statistics& s) { s.obstacle = obstacle; });
  if (!obstacle.empty()) {
    report_once("cannot search for the Cortex host yet: " + obstacle);
  }
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
  if (!down_reported_ && now - search_began_ >= options_.search_patience) {
    down_reported_ = true;
    const std::string obstacle = statistics().obstacle;
    events_.on_host_down(obstacle.empty() ? "no answer from " + target()
                                          : "the search for " + target() + " cannot begin: " + obstacle);
  }
}

void Client::connect(const Endpoint& host, const Identity& identity) {
  const bool known = set_up_host_ == host.address();
  const Time now = clock_.monotonic();
  if (!known) {
    set_up_host_.reset();
    info_ = HostInfo();
  }
  host_ = host;
  found_at_ = now;
  info_.endpoint = host;
  info_.identity = identity;
  update_statistics([&](Statistics& s) {
    ++s.connects;
    s.host = to_string(host);
  });
  open_stream_socket();
  if (stream_ && !options_.stream_group.empty()) {
    join_group();
  }
  newest_.reset();
  requests_.clear();
  begin_setup();
  if (known) {
    start_running();  // its frames can be read by what is known, while they are read again
    events_.on_host_up(info_);
  } else {
    phase_ = Phase::kFirstSetUp;
  }
}

void Client::ask(const std::string& text, std::function<void(const GeneralReply*)> done) {
  requests_.push(RequestQueue::Kind::kText, encode_text_request(text),
                 [done = std::move(done)](const Packet* answer) {
                   done(answer == nullptr ? nullptr : std::get_if<GeneralReply>(answer));
                 });
}

// LiveMode comes last: by then everything is known that is needed to read the first frame. No answer, or none
// that makes sense, changes nothing: a host that was in inches does not turn to millimetres by its silence.
void Client::begin_setup() {
  setting_up_ = true;
  last_setup_ = clock_.monotonic();
  const auto learn = [](auto& known, const auto& answer) {
    if (answer) {
      known = answer;
    }
  };
  ask("GetConversionToMillimeters", [this, learn](const GeneralReply* reply) {
    learn(info_.millimetres_per_unit, number_within(reply, kMinMillimetresPerUnit, kMaxMillimetresPerUnit));
  });
  ask("GetUpAxis", [this, learn](const GeneralReply* reply) { learn(info_.up_axis, axis_number(reply)); });
  ask("GetContextFrameRate", [this, learn](const GeneralReply* reply) {
    learn(info_.frame_rate_hz, number_within(reply, kMinFrameRateHz, kMaxFrameRateHz));
  });
  requests_.push(RequestQueue::Kind::kBodyDefs, encode_request(Command::kRequestBodyDefs),
                 [this](const Packet* answer) {
                   if (const auto* defs = answer == nullptr ? nullptr : std::get_if<BodyDefs>(answer)) {
                     info_.bodies = defs->bodies;
                   }
                 });
  if (options_.live_on_start) {
    ask("LiveMode", [this](const GeneralReply* reply) { info_.live_mode_accepted = reply != nullptr; });
  }
}

void Client::finish_setup() {
  setting_up_ = false;
  set_up_host_ = host_->address();
  if (phase_ != Phase::kRunning) {
    start_running();
  }
  events_.on_host_up(info_);
}

void Client::start_running() {
  const Time now = clock_.monotonic();
  phase_ = Phase::kRunning;
  down_reported_ = false;
  polls_without_news_ = 0;
  last_stream_frame_ = now;  // the stream gets its time to begin
  next_poll_ = now;
  feed_ = options_.mode == Mode::kPoll || !stream_ ? Feed::kPoll : Feed::kStream;
  update_statistics([&](Statistics& s) {
    s.host_up = true;
    s.feed = feed_;
  });
}

void Client::lose_host() {
  const std::string name = to_string(*host_);
  const Time now = clock_.monotonic();
  host_.reset();
  phase_ = Phase::kSearching;
  setting_up_ = false;
  requests_.clear();
  polled_at_.reset();
  search_began_ = now;
  next_hello_ = now;
  hello_interval_ = options_.hello_interval;
  update_statistics([&](Statistics& s) {
    s.host_up = false;
    s.host = target();
  });
  if (!down_reported_) {
    down_reported_ = true;
    events_.on_host_down("nothing heard from " + name + " for " +
                         std::to_string(to_seconds(options_.host_timeout)) + " s");
  }
}

void Client::open_stream_socket() {
  if (stream_ || options_.mode == Mode::kPoll) {
    return;
  }
  try {
    // Bound to any address, because some hosts send the stream by unicast.
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
  // Without a configured interface take the one that leads to the host: the route for the group, which the
  // kernel would use, is often another one or missing.
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
  if (phase_ == Phase::kSearching) {
    search(now);
    return;
  }
  watch_host(now);
  if (phase_ == Phase::kRunning) {
    choose_feed(now);
    poll_if_due(now);
  }
  flush(requests_, now);
  if (setting_up_ && requests_.idle()) {
    finish_setup();
  }
}

void Client::watch_host(Time now) {
  const Time silence = now - last_heard_;
  if (silence >= options_.host_timeout) {
    lose_host();
  } else if (silence >= options_.probe_interval && now >= next_probe_) {
    send_hello(now);
  }
}

void Client::choose_feed(Time now) {
  const bool no_stream = now - last_stream_frame_ >= options_.stream_timeout;
  const bool poll = options_.mode == Mode::kPoll || !stream_ || (options_.mode == Mode::kAuto && no_stream);
  const Feed chosen = poll ? Feed::kPoll : Feed::kStream;
  if (chosen == feed_) {
    return;
  }
  feed_ = chosen;
  next_poll_ = now;
  update_statistics([&](Statistics& s) { s.feed = chosen; });
  events_.on_feed(chosen);
}

// A paused host need not be asked 200 times a second.
Time Client::poll_period() const {
  return polls_without_news_ >= kQuietPolls
             ? kQuietPollPeriod
             : from_seconds(1.0 / info_.frame_rate_hz.value_or(options_.frame_rate_hz));
}

void Client::poll_if_due(Time now) {
  if (polled_at_ && now - *polled_at_ >= options_.poll_timeout) {
    polled_at_.reset();
    update_statistics([](Statistics& s) { ++s.poll_timeouts; });
  }
  if (feed_ != Feed::kPoll || now < next_poll_ || polled_at_) {
    return;
  }
  next_poll_ += poll_period();
  if (next_poll_ <= now) {
    next_poll_ = now + poll_period();
  }
  polled_at_ = now;
  command_->send(encode_request(Command::kRequestFrame), *host_);
}

void Client::flush(RequestQueue& requests, Time now) {
  while (const std::optional<Bytes> packet = requests.update(now)) {
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
    } else if (phase_ == Phase::kRunning && feed_ == Feed::kPoll) {
      next = std::min(next, next_poll_);
    }
  }
  return std::max(next - now, Time{0});
}

void Client::wait(Time time) {
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(time);
  const timespec timeout{static_cast<time_t>(seconds.count()), static_cast<long>((time - seconds).count())};
  // poll() passes over an entry with a negative descriptor.
  pollfd waiting[] = {{command_ ? command_->fd() : -1, POLLIN, 0}, {stream_ ? stream_->fd() : -1, POLLIN, 0}};
  ppoll(waiting, std::size(waiting), &timeout, nullptr);
}

void Client::pause_host() {
  RequestQueue pause(kPauseTimeout, kPauseTries);
  pause.push(RequestQueue::Kind::kText, encode_text_request("Pause"), nullptr);
  std::swap(requests_, pause);
  while (!requests_.idle()) {
    receive(*command_, Channel::kCommand);
    flush(requests_, clock_.monotonic());
    wait(std::chrono::milliseconds(10));
  }
}

}  // namespace cortex_ros
