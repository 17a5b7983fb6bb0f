// Node recorder: records topics into a bag, as `rosbag record -e` does, but takes less processor time and
// copes with failures of the disk and changes of the clock.
//
// rosbag passes every message from the receiving thread to the spinning thread to the writing thread: in a
// flight, three threads are woken a thousand times a second. Here the receiving thread puts the message into
// a chunk of the bag, and another thread writes full chunks a few times a second.

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/callback_queue_interface.h>
#include <ros/ros.h>
#include <sys/stat.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <cstdlib>
#include <ctime>
#include <deque>
#include <filesystem>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <regex>
#include <sstream>
#include <string>
#include <system_error>
#include <thread>
#include <typeinfo>
#include <utility>
#include <vector>

#include "bag_file.hpp"

namespace data_extraction {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;          // never set back
using Header = boost::shared_ptr<ros::M_string>;  // of a connection, shared by its messages

constexpr std::size_t kMegabyte = 1u << 20;
// A chunk is as large as those of rosbag: small enough to be read as a whole, large enough that its index is
// small in comparison. A chunk that fills slowly is written after a second anyway: only that second is lost
// if this process is killed.
constexpr std::size_t kChunkBytes = 768u << 10;
constexpr auto kChunkPeriod = std::chrono::seconds(1);
constexpr auto kWritePeriod = std::chrono::milliseconds(250);  // how often full chunks are written
constexpr auto kLookPeriod = std::chrono::seconds(1);          // how often the master is asked for new topics
constexpr double kLogPeriodS = 5.0;

struct Options {
  std::string name;  // of the bag, without .bag
  double most_bytes;
  std::map<std::string, double> most_hz;  // by topic
  std::vector<std::regex> topics;
};

std::string time_text(std::time_t time) {
  char text[32];
  std::strftime(text, sizeof text, "_%Y-%m-%d-%H-%M-%S", std::localtime(&time));
  return text;
}

// 0 if the text is not a number.
double number_of(const std::string& text) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  return *end == '\0' ? value : 0.0;
}

std::string why_no_size(const std::string& text) {
  return number_of(text) > 0.0 ? "" : "needs a number above 0, found '" + text + "'";
}

std::string why_no_limit(const std::string& text) {
  const std::size_t equals = text.find('=');
  return equals == std::string::npos ? "needs TOPIC=HZ, found '" + text + "'"
                                     : why_no_size(text.substr(equals + 1));
}

std::string why_no_pattern(const std::string& text) try {
  std::regex{text};
  return "";
} catch (const std::regex_error& error) {
  return "'" + text + "' is not a regular expression: " + error.what();
}

// Throws CLI::Error; afterwards `app` can print the help.
Options parse(CLI::App& app, const std::vector<std::string>& arguments) {
  Options options;
  fs::path file, prefix;
  std::string most_mb = "512";
  std::vector<std::string> limits, patterns;
  CLI::App* name = app.add_option_group("name")->require_option(1);
  name->add_option("-O", file, "write this bag; .bag is appended where it is missing");
  name->add_option("-o", prefix, "write a bag whose name begins so, followed by the time");
  app.add_option("-b", most_mb, "[MB] may wait for a slow disk; what exceeds it is not recorded")
      ->check(why_no_size)
      ->capture_default_str();
  app.add_option("-l", limits, "TOPIC=HZ: of this topic write at most HZ messages a second")
      ->check(why_no_limit)
      ->allow_extra_args(false);
  app.add_option("REGEX", patterns, "topics whose whole name matches one of these are recorded")
      ->required()
      ->check(why_no_pattern);
  app.parse(std::vector<std::string>(arguments.rbegin(), arguments.rend()));
  fs::path& given = file.empty() ? prefix : file;
  options.name = given.extension() == ".bag" ? given.replace_extension() : given;
  options.name += file.empty() ? time_text(std::time(nullptr)) : "";
  options.most_bytes = number_of(most_mb) * kMegabyte;
  for (const std::string& limit : limits) {
    const std::size_t equals = limit.find('=');
    options.most_hz[limit.substr(0, equals)] = number_of(limit.substr(equals + 1));
  }
  options.topics = {patterns.begin(), patterns.end()};
  return options;
}

// roscpp stops logging when its shutdown begins; the final messages come later.
void say(bool good, const std::string& text) {
  if (ros::isShuttingDown()) {
    std::cerr << "recorder: " << text << std::endl;
  } else if (good) {
    ROS_INFO_STREAM(text);
  } else {
    ROS_ERROR_STREAM(text);
  }
}

// Renames an earlier file of this name: adds its modification time to the name. Throws fs::filesystem_error.
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

// Name of the bag while it is being written, as in rosbag. Makes its folder and renames a file that a killed
// recorder left there. Throws std::system_error when another recorder is writing it.
std::string active_name(const std::string& name) {
  fs::create_directories(fs::absolute(name).parent_path());
  const std::string suffix = ".bag.active";
  if (BagFile::is_being_written(name + suffix)) {
    throw std::system_error(EBUSY, std::generic_category(), "another recorder is writing it");
  }
  set_aside(name, suffix);
  return name + suffix;
}

// Runs callbacks at once, in the thread that received the message.
class AtOnce : public ros::CallbackQueueInterface {
 public:
  void addCallback(const ros::CallbackInterfacePtr& callback, uint64_t) override {
    while (callback->call() == ros::CallbackInterface::TryAgain) {  // another thread is running it
      std::this_thread::yield();
    }
  }
  void removeByID(uint64_t) override {}
};

// Messages of any type, as raw bytes. topic_tools::ShapeShifter also copies type, MD5 sum and definition for
// every message; the connection has them already.
class Raw : public ros::SubscriptionCallbackHelper {
 public:
  using Take = std::function<void(const std::string&, ros::Time received, const Header&)>;
  explicit Raw(Take take) : take_(std::move(take)) {}
  ros::VoidConstPtr deserialize(const ros::SubscriptionCallbackHelperDeserializeParams& params) override {
    return boost::make_shared<std::string>(reinterpret_cast<const char*>(params.buffer), params.length);
  }
  void call(ros::SubscriptionCallbackHelperCallParams& params) override {
    const auto& event = params.event;
    take_(*static_cast<const std::string*>(event.getMessage().get()), event.getReceiptTime(),
          event.getConnectionHeaderPtr());
  }
  const std::type_info& getTypeInfo() override { return typeid(std::string); }
  bool isConst() override { return true; }
  bool hasHeader() override { return false; }

 private:
  Take take_;
};

class Recorder {
 public:
  Recorder(const ros::NodeHandle& node, const Options& options)
      : node_(node), options_(options), active_(active_name(options.name)), bag_(active_) {
    diagnostics_.setHardwareID("none");
    diagnostics_.add("recorder", this, &Recorder::diagnose);
  }

  // By now the bag is complete or abandoned. Ends roscpp's threads and the watcher first, since they use the
  // members. That may take long when the master cannot be reached.
  ~Recorder() {
    stop_taking();
    ros::shutdown();
    if (watcher_.joinable()) {
      watcher_.join();
    }
  }

  // Records until shutdown, or until the bag can no longer be written. Returns whether all is in the bag.
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
  struct Source {  // a subscribed topic
    std::string topic;
    ros::Duration period;  // records at most one message per period
    ros::Time last = ros::TIME_MAX;
    std::map<Header, std::uint32_t> connections{};  // by address, which is fast
  };
  struct Seen {  // a topic that the master knows
    std::string type;
    ros::Subscriber subscriber;  // none if the topic is not recorded
  };

  // Asks the master for topics periodically, in a thread of its own, since the answer may take long.
  void watch() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (!over_) {
      lock.unlock();
      look();
      diagnostics_.force_update();
      lock.lock();
      over_changed_.wait_for(lock, kLookPeriod, [this] { return over_; });
    }
  }

  void look() {
    if (!ros::Time::isValid()) {
      ROS_WARN_ONCE("/use_sim_time is set and there is no /clock yet: nothing is recorded before it");
      return;
    }
    ros::master::V_TopicInfo topics;
    ros::master::getTopics(topics);
    for (const ros::master::TopicInfo& topic : topics) {
      Seen& seen = seen_[topic.name];
      if (seen.type == topic.datatype) {
        continue;
      }
      // A subscriber keeps the first type that it receives: when the type changes, a new one is needed.
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
    const auto source = std::make_shared<Source>(Source{topic, period});
    const auto take = [this, source](const std::string& message, ros::Time received, const Header& header) {
      this->take(*source, message, received, header);
    };
    ros::SubscribeOptions options(topic, 0, "*", "*");
    options.helper = boost::make_shared<Raw>(take);
    options.transport_hints = ros::TransportHints().tcpNoDelay();
    options.callback_queue = &at_once_;
    return node_.subscribe(options);
  }

  void take(Source& source, const std::string& message, ros::Time received, const Header& header) {
    received = std::max(received, ros::TIME_MIN);  // a bag has no time 0
    const std::lock_guard<std::mutex> lock(mutex_);
    // if the clock was set back, a new period begins
    if (over_ || (source.last <= received && received < source.last + source.period)) {
      return;
    }
    source.last = received;
    if (held_bytes_ + filling_.bytes() + message.size() + Chunk::kBytesAround > options_.most_bytes) {
      ++dropped_;
      return;
    }
    const std::uint32_t connection = connection_of(source, header);
    filling_.add_message(connection, received, message);
    ++taken_;
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
    return source.connections[header] = connection->second;
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

  // Writes the full chunks and, with `cut`, also the one that is being filled. Throws std::system_error.
  void write_chunks(bool cut) {
    std::unique_lock<std::mutex> lock(mutex_);
    if (cut && filling_.messages() != 0) {
      cut_chunk();
    }
    for (std::size_t left = full_.size(); left != 0; --left) {
      const Chunk& chunk = full_.front();  // its address stays valid while others are added
      lock.unlock();
      bag_.write(chunk);
      lock.lock();
      held_bytes_ -= chunk.bytes();
      full_.pop_front();
    }
    const std::size_t dropped = dropped_;
    lock.unlock();  // logging to the same slow disk must not block arriving messages
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

  // Text: how many messages are in the bag and how many are not.
  std::string recorded() const {
    const std::size_t lost = taken_ - bag_.messages();
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
    status.summary(diagnostic_msgs::DiagnosticStatus::OK, "recording");
    if (dropped_ != 0) {
      status.summary(diagnostic_msgs::DiagnosticStatus::WARN,
                     "the disk is too slow: messages were not recorded");
    }
    status.add("file", options_.name + ".bag");
    status.add("messages recorded", taken_);
    status.add("messages not recorded", dropped_);
    status.add("bytes waiting for the disk", held_bytes_ + filling_.bytes());
  }

  ros::NodeHandle node_;
  const Options options_;
  const std::string active_;
  BagFile bag_;
  AtOnce at_once_;
  std::thread watcher_;

  // Used by the watcher's thread only, and after its end.
  std::map<std::string, Seen> seen_;  // by topic
  diagnostic_updater::Updater diagnostics_;

  std::mutex mutex_;  // guards what follows
  std::condition_variable over_changed_;
  bool over_ = false;
  std::map<std::pair<std::string, ros::M_string>, std::uint32_t> connections_;  // by topic and header
  Chunk filling_;
  std::deque<Chunk> full_;
  std::size_t held_bytes_ = 0;  // of full_
  std::size_t taken_ = 0;       // messages
  std::size_t dropped_ = 0;
};

void on_terminate(int) {
  ros::requestShutdown();
}

}  // namespace
}  // namespace data_extraction

int main(int argc, char** argv) {
  using namespace data_extraction;
  ros::init(argc, argv, "recorder");
  // roscpp handles SIGINT. Process managers send SIGTERM, a closing terminal SIGHUP (ignored under nohup).
  std::signal(SIGTERM, on_terminate);
  if (std::signal(SIGHUP, on_terminate) == SIG_IGN) {
    std::signal(SIGHUP, SIG_IGN);
  }
  std::signal(SIGXFSZ, SIG_IGN);  // reaching the file size limit becomes an error of the write
  CLI::App app("Topics into a bag, as `rosbag record -e` does.", "recorder");
  Options options;
  try {
    options = parse(app, {argv + 1, argv + argc});
  } catch (const CLI::CallForHelp&) {
    std::cout << app.help();
    return 0;
  } catch (const CLI::Error& error) {
    ROS_FATAL_STREAM(error.what() << "\n" << app.help());
    return 1;
  }
  ros::NodeHandle node;  // outlives the recorder: logging ends with the last node handle
  try {
    return Recorder(node, options).run() ? 0 : 1;
  } catch (const std::system_error& error) {
    ROS_FATAL("%s.bag: %s: may you write there?", options.name.c_str(), error.what());
    return 1;
  }
}
