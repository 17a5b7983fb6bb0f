// Node recorder: topics into a bag, as `rosbag record` does.
//
// rosbag hands every message from the thread that received it to one that spins, to one that writes: three
// threads are woken a thousand times a second for a flight. Here the thread that received a message puts it
// into a chunk of the bag, and another one writes full chunks a few times a second.

#include <diagnostic_updater/diagnostic_updater.h>
#include <fcntl.h>
#include <ros/callback_queue_interface.h>
#include <ros/ros.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <cstdlib>
#include <ctime>
#include <deque>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <regex>
#include <sstream>
#include <stdexcept>
#include <string>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "bag_file.hpp"

namespace data_extraction {

// The bytes of a message of whatever type. topic_tools::ShapeShifter holds type, MD5 sum and definition
// besides, copied for every message; the connection has them.
struct AnyMessage {
  std::string bytes;
};

}  // namespace data_extraction

namespace ros {
namespace message_traits {

template <>
struct MD5Sum<data_extraction::AnyMessage> {
  static const char* value() { return "*"; }
};

template <>
struct DataType<data_extraction::AnyMessage> {
  static const char* value() { return "*"; }
};

}  // namespace message_traits

namespace serialization {

template <>
struct Serializer<data_extraction::AnyMessage> {
  template <typename Stream>
  static void read(Stream& stream, data_extraction::AnyMessage& message) {
    message.bytes.assign(reinterpret_cast<const char*>(stream.getData()), stream.getLength());
  }
};

}  // namespace serialization
}  // namespace ros

namespace data_extraction {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;  // nobody sets it
using Event = ros::MessageEvent<AnyMessage const>;
using Header = boost::shared_ptr<ros::M_string>;  // of a connection, by which its messages know it

constexpr const char* kUsage =
    "usage: recorder (-O FILE | -o PREFIX) [-b MB] [-l TOPIC=HZ]... REGEX...\n"
    "  -O FILE       write this bag; .bag is appended where it is missing\n"
    "  -o PREFIX     write a bag whose name begins so and holds the time\n"
    "  -b MB         so much may wait for a slow disk, default 512; what comes then is not recorded\n"
    "  -l TOPIC=HZ   of this topic write at most so many messages a second\n"
    "  REGEX         topics whose whole name matches one of these are recorded";
constexpr std::size_t kMegabyte = 1u << 20;
// A chunk is as large as those of rosbag: small enough to be read as a whole, so large that its index is
// little. One that fills slowly is written after a second all the same: so much is lost if this process is
// killed.
constexpr std::size_t kChunkBytes = 768u << 10;
constexpr auto kChunkPeriod = std::chrono::seconds(1);
constexpr auto kWritePeriod = std::chrono::milliseconds(250);  // how often full chunks are written
constexpr auto kLookPeriod = std::chrono::seconds(1);          // how often the master is asked for new topics
constexpr double kLogPeriodS = 5.0;

struct Options {
  std::string name;  // of the bag, without .bag
  std::size_t most_bytes = 512 * kMegabyte;
  std::map<std::string, double> most_hz;  // by topic
  std::vector<std::regex> topics;
};

std::string time_text(std::time_t time) {
  char text[32];
  std::strftime(text, sizeof text, "_%Y-%m-%d-%H-%M-%S", std::localtime(&time));
  return text;
}

std::string without_suffix(const std::string& name) {
  const std::string suffix = ".bag";
  const bool has =
      name.size() >= suffix.size() && name.compare(name.size() - suffix.size(), suffix.size(), suffix) == 0;
  return has ? name.substr(0, name.size() - suffix.size()) : name;
}

double positive(const std::string& option, const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0' || !(value > 0.0)) {
    throw std::invalid_argument(option + " needs a number above 0, found '" + text + "'");
  }
  return value;
}

Options parse(const std::vector<std::string>& arguments) {
  Options options;
  for (auto argument = arguments.begin(); argument != arguments.end(); ++argument) {
    if (argument->rfind('-', 0) != 0) {
      try {
        options.topics.emplace_back(*argument);
      } catch (const std::regex_error& error) {
        throw std::invalid_argument("'" + *argument + "' is no regular expression: " + error.what());
      }
      continue;
    }
    const std::string option = *argument;
    if (option.find_first_not_of("-Oobl") != std::string::npos || option.size() != 2) {
      throw std::invalid_argument("unknown option " + option + "\n" + kUsage);
    }
    if (++argument == arguments.end()) {
      throw std::invalid_argument(option + " needs a value\n" + kUsage);
    }
    if (option == "-O") {
      options.name = without_suffix(*argument);
    } else if (option == "-o") {
      options.name = without_suffix(*argument) + time_text(std::time(nullptr));
    } else if (option == "-b") {
      options.most_bytes = static_cast<std::size_t>(positive(option, *argument) * kMegabyte);
    } else {
      const auto equals = argument->find('=');
      const std::string hz = equals == std::string::npos ? "" : argument->substr(equals + 1);
      options.most_hz[argument->substr(0, equals)] = positive("-l TOPIC=HZ", hz);
    }
  }
  if (options.name.empty() || options.topics.empty()) {
    throw std::invalid_argument(kUsage);
  }
  return options;
}

// roscpp's log ends when its shutdown begins, and the last words come later.
void say(bool good, const std::string& text) {
  if (ros::isShuttingDown()) {
    std::cerr << "recorder: " << text << std::endl;
  } else if (good) {
    ROS_INFO_STREAM(text);
  } else {
    ROS_ERROR_STREAM(text);
  }
}

// An earlier file of this name keeps what it holds, under a name with its time. Throws fs::filesystem_error.
void set_aside(const std::string& name, const std::string& suffix) {
  struct stat status;
  if (::stat((name + suffix).c_str(), &status) != 0) {
    return;
  }
  const std::string dated = name + time_text(status.st_mtime);
  std::string other = dated + suffix;
  for (int number = 2; fs::exists(other); ++number) {
    other = dated + "_" + std::to_string(number) + suffix;
  }
  fs::rename(name + suffix, other);
  say(true, name + suffix + " was there already: it is now called " + other);
}

// The name of a bag while it is being written, as rosbag has it; its folder is made. What a killed recorder
// left there is set aside. Throws std::system_error when another recorder is writing it.
std::string active_name(const std::string& name) {
  try {
    fs::create_directories(fs::absolute(name).parent_path());
  } catch (const fs::filesystem_error& error) {
    throw std::system_error(error.code(), name + ": no folder for it");
  }
  const std::string suffix = ".bag.active";
  const int file = ::open((name + suffix).c_str(), O_RDONLY | O_CLOEXEC);
  if (file >= 0) {
    const bool taken = ::flock(file, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
    ::close(file);
    if (taken) {
      throw std::system_error(EBUSY, std::generic_category(), "another recorder is writing " + name + suffix);
    }
    set_aside(name, suffix);
  }
  return name + suffix;
}

// Runs callbacks at once, in the thread that received the message.
class AtOnce : public ros::CallbackQueueInterface {
 public:
  void addCallback(const ros::CallbackInterfacePtr& callback, uint64_t) override {
    while (callback->call() == ros::CallbackInterface::TryAgain) {  // another thread is in it
      std::this_thread::yield();
    }
  }
  void removeByID(uint64_t) override {}
};

// Lets one pass a period. A clock that was set back begins a new one.
class Limit {
 public:
  explicit Limit(ros::Duration period) : period_(period) {}
  bool passes(ros::Time now) {
    if (last_ <= now && now < last_ + period_) {
      return false;
    }
    last_ = now;
    return true;
  }

 private:
  ros::Duration period_;
  ros::Time last_ = ros::TIME_MAX;  // so that the first one passes
};

class Recorder {
 public:
  Recorder(const ros::NodeHandle& node, const Options& options)
      : node_(node), options_(options), active_(active_name(options.name)), bag_(active_) {
    diagnostics_.setHardwareID("none");
    diagnostics_.add("recorder", this, &Recorder::diagnose);
  }

  // The bag is complete or given up by now. roscpp's threads and the watcher use what is here: they end
  // first. That may take long, where the master is out of reach.
  ~Recorder() {
    stop_taking();
    ros::shutdown();
    if (watcher_.joinable()) {
      watcher_.join();
    }
  }

  // Records until shutdown, or until the bag can be written no longer. Returns whether all is in the bag.
  bool run() {
    std::string trouble;
    try {
      watcher_ = std::thread([this] { watch(); });
      auto next_cut = Clock::now() + kChunkPeriod;
      while (!ros::isShuttingDown()) {
        std::this_thread::sleep_for(kWritePeriod);
        const bool cut = Clock::now() >= next_cut;
        write_chunks(cut);
        next_cut = cut ? Clock::now() + kChunkPeriod : next_cut;
      }
      stop_taking();
      write_chunks(true);
    } catch (const std::exception& error) {
      trouble = error.what();
    }
    stop_taking();
    return finish(trouble);
  }

 private:
  struct Source {  // of messages: a topic that is subscribed to
    std::string topic;
    Limit limit;
    std::map<Header, std::uint32_t> connections;  // by address, which is fast
  };
  struct Seen {  // a topic that the master knows
    std::string type;
    ros::Subscriber subscriber;  // none where it is not wanted
  };

  // Asks the master for topics again and again: in a thread of its own, since the answer may be long in
  // coming.
  void watch() {
    std::unique_lock<std::mutex> lock(mutex_);
    do {
      lock.unlock();
      look();
      diagnostics_.force_update();
      lock.lock();
    } while (!over_changed_.wait_for(lock, kLookPeriod, [this] { return over_; }));
  }

  void look() {
    if (!ros::Time::isValid()) {
      ROS_WARN_ONCE("/use_sim_time is set and there is no /clock yet: nothing is recorded before it");
      return;
    }
    ros::master::V_TopicInfo topics;
    if (!ros::master::getTopics(topics)) {
      return;
    }
    for (const ros::master::TopicInfo& topic : topics) {
      Seen& seen = seen_[topic.name];
      if (seen.type == topic.datatype) {
        continue;
      }
      // A subscriber takes the first type that it gets and no other: where the type changes, a new one is
      // needed.
      seen = Seen{topic.datatype, {}};
      const auto matches = [&](const std::regex& pattern) { return std::regex_match(topic.name, pattern); };
      try {
        if (std::any_of(options_.topics.begin(), options_.topics.end(), matches)) {
          seen.subscriber = subscribe(topic.name);
        }
      } catch (const std::runtime_error& error) {
        ROS_ERROR("%s is not recorded: %s", topic.name.c_str(), error.what());
      }
    }
  }

  ros::Subscriber subscribe(const std::string& topic) {
    const auto limit = options_.most_hz.find(topic);
    const ros::Duration period(limit == options_.most_hz.end() ? 0.0 : 1.0 / limit->second);
    const auto source = std::make_shared<Source>(Source{topic, Limit(period), {}});
    ros::SubscribeOptions options;
    options.topic = topic;
    options.queue_size = 0;
    options.md5sum = ros::message_traits::md5sum<AnyMessage>();
    options.datatype = ros::message_traits::datatype<AnyMessage>();
    options.transport_hints = ros::TransportHints().tcpNoDelay();
    options.callback_queue = &at_once_;
    options.helper = boost::make_shared<ros::SubscriptionCallbackHelperT<const Event&>>(
        [this, source](const Event& event) { take(*source, event); });
    return node_.subscribe(options);
  }

  void take(Source& source, const Event& event) {
    const ros::Time received = std::max(event.getReceiptTime(), ros::TIME_MIN);  // a bag has no time 0
    const std::string& bytes = event.getMessage()->bytes;
    const std::lock_guard<std::mutex> lock(mutex_);
    if (over_ || !source.limit.passes(received)) {
      return;
    }
    if (held_bytes_ + filling_.bytes() + bytes.size() + Chunk::kBytesAround > options_.most_bytes) {
      ++dropped_;
      return;
    }
    filling_.add_message(connection_of(source, event.getConnectionHeaderPtr()), received, bytes);
    if (filling_.bytes() >= kChunkBytes) {
      cut_chunk();
    }
  }

  std::uint32_t connection_of(Source& source, const Header& header) {
    const auto known = source.connections.find(header);
    if (known != source.connections.end()) {
      return known->second;
    }
    const auto id = static_cast<std::uint32_t>(connections_.size());
    const auto [connection, is_new] = connections_.try_emplace({source.topic, *header}, id);  // or it is back
    if (is_new) {
      filling_.add_connection(id, source.topic, *header);
    }
    source.connections.emplace(header, connection->second);
    return connection->second;
  }

  void cut_chunk() {
    held_bytes_ += filling_.bytes();
    full_.push_back(std::exchange(filling_, Chunk()));
  }

  void stop_taking() {
    const std::lock_guard<std::mutex> lock(mutex_);
    over_ = true;
    over_changed_.notify_all();
  }

  // Writes chunks that are full now, and with `cut` the one that fills, too. Throws std::system_error.
  void write_chunks(bool cut) {
    std::unique_lock<std::mutex> lock(mutex_);
    if (cut && filling_.messages() != 0) {
      cut_chunk();
    }
    for (std::size_t left = full_.size(); left != 0; --left) {
      const Chunk& chunk = full_.front();  // stays where it is while others are added
      lock.unlock();
      bag_.write(chunk);
      lock.lock();
      written_ += chunk.messages();
      held_bytes_ -= chunk.bytes();
      full_.pop_front();
    }
    const std::size_t dropped = dropped_;
    lock.unlock();
    if (dropped != 0) {
      ROS_WARN_THROTTLE(kLogPeriodS, "the disk is too slow: %zu messages were not recorded so far", dropped);
    }
  }

  bool finish(const std::string& trouble) {
    const std::string path = options_.name + ".bag";
    std::ostringstream text;
    bool good = trouble.empty() && dropped_ == 0;
    try {
      bag_.finish();
      set_aside(options_.name, ".bag");
      fs::rename(active_, path);
      text << path << ": " << (trouble.empty() ? "" : trouble + ": recording ended. ") << recorded()
           << (trouble.empty() ? "" : ". Make room or choose another folder, and record again");
    } catch (const std::system_error& error) {
      good = false;
      text << active_ << ": " << error.code().message() << ": recording ended without an index. "
           << recorded() << ". Make room, run `rosbag reindex " << active_ << "` and rename it to " << path;
    }
    say(good, text.str());
    return good;
  }

  // What is in the bag and what is not, in words.
  std::string recorded() const {
    std::size_t lost = written_ - bag_.messages() + filling_.messages();
    for (const Chunk& chunk : full_) {
      lost += chunk.messages();
    }
    std::ostringstream text;
    text << bag_.messages() << " messages, " << bag_.bytes() / kMegabyte << " MB, were recorded";
    if (lost != 0) {
      text << ", the " << lost << " after them were not";
    }
    if (dropped_ != 0) {
      text << ", " << dropped_ << " were not because the disk was too slow";
    }
    return text.str();
  }

  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (dropped_ == 0) {
      status.summary(diagnostic_msgs::DiagnosticStatus::OK, "recording");
    } else {
      status.summary(diagnostic_msgs::DiagnosticStatus::WARN,
                     "the disk is too slow: messages were not recorded");
    }
    status.add("file", options_.name + ".bag");
    status.add("messages recorded", written_);
    status.add("messages not recorded", dropped_);
    status.add("bytes waiting for the disk", held_bytes_ + filling_.bytes());
  }

  ros::NodeHandle node_;
  const Options options_;
  const std::string active_;
  BagFile bag_;
  AtOnce at_once_;
  std::thread watcher_;

  // Touched by the watcher's thread only, and after its end.
  std::map<std::string, Seen> seen_;  // by topic
  diagnostic_updater::Updater diagnostics_;

  std::mutex mutex_;  // guards what follows
  std::condition_variable over_changed_;
  bool over_ = false;
  std::map<std::pair<std::string, ros::M_string>, std::uint32_t> connections_;  // by topic and header
  Chunk filling_;
  std::deque<Chunk> full_;
  std::size_t held_bytes_ = 0;  // of full_
  std::size_t written_ = 0;     // messages
  std::size_t dropped_ = 0;
};

// roscpp handles SIGINT. Process managers send SIGTERM, a terminal that closes SIGHUP (nohup says: ignore
// it).
void on_terminate(int) {
  ros::requestShutdown();
}

void handle_signals() {
  std::signal(SIGTERM, on_terminate);
  if (std::signal(SIGHUP, on_terminate) == SIG_IGN) {
    std::signal(SIGHUP, SIG_IGN);
  }
  std::signal(SIGXFSZ, SIG_IGN);  // a file that is as large as it may be is an error of the write
}

int run_node(int argc, char** argv) {
  ros::init(argc, argv, "recorder");
  handle_signals();
  ros::NodeHandle node;  // outlives the try block: with the last node handle the logging ends too
  try {
    std::vector<std::string> arguments;
    ros::removeROSArgs(argc, argv, arguments);
    arguments.erase(arguments.begin());
    return Recorder(node, parse(arguments)).run() ? 0 : 1;
  } catch (const std::invalid_argument& error) {
    ROS_FATAL("%s", error.what());
  } catch (const std::system_error& error) {
    ROS_FATAL("%s: may you write there?", error.what());
  }
  return 1;
}

}  // namespace
}  // namespace data_extraction

int main(int argc, char** argv) {
  return data_extraction::run_node(argc, argv);
}
