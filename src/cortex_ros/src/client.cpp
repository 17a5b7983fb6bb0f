#include "cortex_ros/client.hpp"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
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

Address resolve_or_any(const std::string& name) {
  return name.empty() ? Address() : resolve(name);
}

FileDescriptor open_event() {
  FileDescriptor fd(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC));
  if (fd.get() < 0) {
    throw NetworkError("cannot create an eventfd", errno);
  }
  return fd;
}

void require_host(const char* option, const std::string& text) {
  if (!text.empty() && !is_well_formed_host(text)) {
    throw std::invalid_argument(std::string(option) + " '" + text +
                                "' is neither a dotted quad nor a host name");
  }
}

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
      wake_(open_event()),
      requests_({options_.request_timeout, RequestQueue::Timing().settle}),
      search_began_(clock.monotonic()),
      hello_interval_(options_.hello_interval),
      next_hello_(search_began_) {
  require_host("host", options_.host);
  require_host("local address", options_.local_address);
  if (!options_.stream_group.empty() &&
      !is_multicast(parse_address(options_.stream_group).value_or(Address()))) {
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

void Client::stop() noexcept {
  stop_ = true;
  const std::uint64_t one = 1;
  // A full counter, the only way to fail, wakes just as well.
  [[maybe_unused]] const ssize_t written = write(wake_.get(), &one, sizeof one);
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
  wait(max_wait);
}

void Client::request(const std::string& text, std::function<void(const Packet*)> done) {
  requests_.push(GeneralRequest{text}, options_.request_tries, std::move(done));
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
    return channel == Channel::kStream ? source.address == host_->address : source == *host_;
  }
  // While searching: the host may answer from another port than the one we called, and is remembered with it.
  if (discovering()) {
    return channel == Channel::kCommand;
  }
  return configured_host_ && source.address == *configured_host_;
}

void Client::handle(const Datagram& datagram, Channel channel) {
  if (!is_from_host(datagram.source, channel)) {
    update_statistics([](Statistics& s) { ++s.foreign; });
    hint_at_other_host(datagram, channel);
    return;
  }
  last_heard_ = clock_.monotonic();
  if (datagram.truncated) {
    refuse("datagram longer than " + std::to_string(datagram.size) + " bytes was truncated");
    return;
  }
  std::optional<Packet> packet;
  try {
    packet = decode(datagram.data, datagram.size);
  } catch (const ProtocolError& error) {
    refuse(error.what());
    return;
  }
  if (host_) {
    dispatch(*packet, datagram, channel);
  } else {
    dispatch_while_searching(*packet, datagram, channel);
  }
}

void Client::refuse(const std::string& what) {
  update_statistics([](Statistics& s) { ++s.malformed; });
  events_.on_malformed(what);
}

// Two mistakes that an answer from another address explains: a host with two interfaces that answers from the
// one that we did not call, and a second host on the network where we took whichever answered first.
void Client::hint_at_other_host(const Datagram& datagram, Channel channel) {
  const bool window =
      discovering() ? host_ && clock_.monotonic() - found_at_ <= options_.search_patience : !host_;
  if (!window || channel != Channel::kCommand || datagram.truncated) {
    return;
  }
  const Endpoint& source = datagram.source;
  try {
    const Packet packet = decode(datagram.data, datagram.size);
    const auto* here = std::get_if<HereIAm>(&packet);
    if (here == nullptr) {
      return;
    }
    if (!discovering()) {
      hint_once(source.address, "a Cortex host answers from " + to_string(source) +
                                    ", not from the configured host " + target() +
                                    ": set the parameter 'host' to " + to_string(source.address));
    } else if (here->identity.version[0] == kCortexProgramId && source.address != host_->address) {
      hint_once(source.address, "more than one Cortex host, or one with two addresses, answers the search: " +
                                    to_string(*host_) + " was first and is used, " + to_string(source) +
                                    " is not: set the parameter 'host' to the right one");
    }
  } catch (const ProtocolError&) {
    // Not from the host, and already counted as foreign.
    return;
  }
}

void Client::handle_answer_to_hello(const Identity& identity, const Endpoint& source) {
  // Other programs speak the protocol, too. A host that the user has named may be any of them.
  if (discovering() && identity.version[0] != kCortexProgramId) {
    update_statistics([](Statistics& s) { ++s.foreign; });
    hint_once(source.address, "program '" + identity.name + "' at " + to_string(source) +
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
      connect({datagram.source.address, options_.command_port}, Identity());
    }
    handle_frame(*frame, datagram, channel);
  } else if (std::holds_alternative<HereIAm>(packet) || std::holds_alternative<HelloWorld>(packet)) {
    next_hello_ = clock_.monotonic();
  }
}

void Client::dispatch(const Packet& packet, const Datagram& datagram, Channel channel) {
  const Time now = clock_.monotonic();
  const bool requested = channel == Channel::kCommand && requests_.offer(packet, now);
  const bool answer = requested || (channel == Channel::kCommand && polls_.offer(packet, now));
  if (const auto* frame = std::get_if<FrameOfData>(&packet)) {
    if (!requested) {  // the answer to a text request may hold base poses, not markers
      handle_frame(*frame, datagram, channel);
    }
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
  hand_on(frame, datagram, feed);
  // After the frame: logging may be slow.
  if (!frame.faults.empty()) {
    update_statistics([&](Statistics& s) { s.faulty_items += frame.faults.size(); });
    events_.on_malformed("frame " + std::to_string(frame.frame) + ": " + frame.faults.front());
  }
}

void Client::hand_on(const FrameOfData& frame, const Datagram& datagram, Feed feed) {
  if (feed == Feed::kPoll && newest_ == frame.frame) {
    ++polls_without_news_;
    return;
  }
  polls_without_news_ = 0;
  newest_ = frame.frame;
  const bool kernel = options_.kernel_timestamps && datagram.kernel_time;
  events_.on_frame({frame, kernel ? *datagram.kernel_time : clock_.wall(), feed});
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
void Client::hint_once(Address about, const std::string& hint) {
  if (hinted_.size() < kMaxReports && hinted_.insert(about.network_order).second) {
    events_.on_problem(hint);
  }
}

void Client::send_hello(Time now) {
  const Bytes hello = encode(HelloWorld{options_.identity});
  next_probe_ = now + options_.probe_interval;
  if (host_) {
    command_->send(hello, *host_);
  } else if (configured_host_) {
    command_->send(hello, {*configured_host_, options_.command_port});
  } else {
    for (Address address : broadcast_addresses(local_)) {
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
      local_ = resolve_or_any(options_.local_address);
      command_.emplace(Endpoint{local_, 0}, UdpSocket::Share::kNo);
    }
  } catch (const NetworkError& error) {
    obstacle = error.what();
    if (error.error_number() == EADDRNOTAVAIL) {
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
  const bool known = set_up_host_ && *set_up_host_ == host.address;
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
  prepare_stream();
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
  request(text, [done = std::move(done)](const Packet* answer) {
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
  requests_.push(RequestBodyDefs(), options_.request_tries, [this](const Packet* answer) {
    if (const auto* defs = answer == nullptr ? nullptr : std::get_if<BodyDefs>(answer)) {
      info_.body_defs = *defs;
    }
  });
  if (options_.live_on_start) {
    ask("LiveMode", [this](const GeneralReply* reply) { info_.live_mode_accepted = reply != nullptr; });
  }
}

void Client::finish_setup() {
  setting_up_ = false;
  set_up_host_ = host_->address;
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
  polls_.clear();
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
        error.error_number() == EACCES
            ? "configure a stream port above 1023 here and at the host, or grant the program "
              "CAP_NET_BIND_SERVICE "
              "(setcap cap_net_bind_service=+ep), or lower net.ipv4.ip_unprivileged_port_start"
            : "end the program that holds the port, or configure another stream port here and at the host";
    report_once(std::string("no stream, polling instead: ") + error.what() + ". To fix it, " + fix);
  }
}

void Client::join_group() {
  if (options_.stream_group.empty()) {
    return;
  }
  // Without a configured interface take the one that leads to the host: the route for the group, which the
  // kernel would use, is often another one or missing.
  try {
    const Address interface =
        local_.any() ? source_address_towards(host_->address).value_or(Address()) : local_;
    stream_->join(*parse_address(options_.stream_group), interface);
  } catch (const NetworkError& error) {
    report_once(
        std::string("no multicast stream: ") + error.what() +
        ". To fix it, set the parameter 'local_address' to this computer's address on the host's network");
  }
}

void Client::prepare_stream() {
  open_stream_socket();
  if (stream_) {
    join_group();
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
  flush_requests(now);
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
  if (feed_ != Feed::kPoll || now < next_poll_ || !polls_.idle()) {
    return;
  }
  next_poll_ += poll_period();
  if (next_poll_ <= now) {
    next_poll_ = now + poll_period();
  }
  polls_.push(RequestFrame(), 1, options_.poll_timeout, [this](const Packet* answer) {
    if (answer == nullptr) {
      update_statistics([](Statistics& s) { ++s.poll_timeouts; });
    }
  });
}

void Client::flush_requests(Time now) {
  for (RequestQueue* queue : {&polls_, &requests_}) {
    while (host_) {
      const std::optional<Bytes> packet = queue->update(now);
      if (!packet) {
        break;
      }
      command_->send(*packet, *host_);
    }
  }
}

Time Client::time_to_next_event(Time now) const {
  Time next = now + kMaxWait;
  if (phase_ == Phase::kSearching) {
    next = std::min(next, next_hello_);
  } else {
    next = std::min(next, requests_.next_event().value_or(next));
    const bool polling = phase_ == Phase::kRunning && feed_ == Feed::kPoll;
    next = std::min(next, polls_.next_event().value_or(polling ? next_poll_ : next));
  }
  return std::max(next - now, Time{0});
}

void Client::wait(Time max_wait) {
  const Time time = std::min(max_wait, time_to_next_event(clock_.monotonic()));
  const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(time);
  const timespec timeout{static_cast<time_t>(seconds.count()), static_cast<long>((time - seconds).count())};
  // poll() passes over an entry with a negative descriptor.
  pollfd waiting[] = {{wake_.get(), POLLIN, 0},
                      {command_ ? command_->fd() : -1, POLLIN, 0},
                      {stream_ ? stream_->fd() : -1, POLLIN, 0}};
  ppoll(waiting, std::size(waiting), &timeout, nullptr);
}

void Client::pause_host() {
  requests_.clear();
  polls_.clear();
  requests_.push(GeneralRequest{"Pause"}, kPauseTries, kPauseTimeout, nullptr);
  while (!requests_.idle()) {
    receive(*command_, Channel::kCommand);
    const Time now = clock_.monotonic();
    flush_requests(now);
    // Not wait(): stop() has woken that one for good.
    pollfd waiting{command_->fd(), POLLIN, 0};
    const timespec timeout{0, Time(std::chrono::milliseconds(10)).count()};
    ppoll(&waiting, 1, &timeout, nullptr);
  }
}

}  // namespace cortex_ros
