// Node recorder: topics into a bag, as `rosbag record` does.
//
// rosbag hands every message from the thread that received it to one that spins, to one that writes: three
// threads are woken a thousand times a second for a flight. Here messages are dated and kept by the thread
// that received them, and written a few times a second.

#include <ros/callback_queue_interface.h>
#include <ros/ros.h>
#include <rosbag/bag.h>
#include <topic_tools/shape_shifter.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <map>
#include <mutex>
#include <regex>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace data_extraction {
namespace {

constexpr const char* kUsage =
    "usage: recorder (-O FILE.bag | -o PREFIX) [-l TOPIC=HZ]... REGEX...\n"
    "  -O FILE.bag   write this bag\n"
    "  -o PREFIX     write a bag whose name begins so and holds the time\n"
    "  -l TOPIC=HZ   of this topic write at most so many messages a second\n"
    "  REGEX         topics whose whole name matches one of these are recorded";
constexpr auto kWritePeriod = std::chrono::milliseconds(250);
constexpr double kLookPeriodS = 1.0;            // how often the master is asked for new topics
constexpr std::size_t kMostBytes = 512u << 20;  // that may wait for the disk
constexpr double kLogPeriodS = 5.0;

using Shape = topic_tools::ShapeShifter;
using Event = ros::MessageEvent<Shape const>;

struct Options {
  std::string file;
  std::map<std::string, double> most_hz;  // by topic
  std::vector<std::regex> topics;
};

std::string time_of_day() {
  char text[32];
  const std::time_t now = std::time(nullptr);
  std::strftime(text, sizeof text, "_%Y-%m-%d-%H-%M-%S", std::localtime(&now));
  return text;
}

Options parse(const std::vector<std::string>& arguments) {
  Options options;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string& argument = arguments[i];
    const bool takes_value = argument == "-O" || argument == "-o" || argument == "-l";
    if (takes_value && i + 1 == arguments.size()) {
      throw std::invalid_argument(argument + " needs a value\n" + kUsage);
    }
    if (argument == "-O") {
      options.file = arguments[++i];
    } else if (argument == "-o") {
      options.file = arguments[++i] + time_of_day() + ".bag";
    } else if (argument == "-l") {
      const std::string& limit = arguments[++i];
      const auto equals = limit.find('=');
      const double hz = equals == std::string::npos ? 0.0 : std::atof(limit.c_str() + equals + 1);
      if (!(hz > 0.0)) {
        throw std::invalid_argument("-l needs TOPIC=HZ with a rate above 0, found " + limit);
      }
      options.most_hz[limit.substr(0, equals)] = hz;
    } else {
      try {
        options.topics.emplace_back(argument);
      } catch (const std::regex_error& error) {
        throw std::invalid_argument("'" + argument + "' is no regular expression: " + error.what());
      }
    }
  }
  if (options.file.empty() || options.topics.empty()) {
    throw std::invalid_argument(kUsage);
  }
  return options;
}

// Runs callbacks at once, in the thread that received the message.
class AtOnce : public ros::CallbackQueueInterface {
 public:
  void addCallback(const ros::CallbackInterfacePtr& callback, uint64_t) override { callback->call(); }
  void removeByID(uint64_t) override {}
};

class Recorder {
 public:
  Recorder(const ros::NodeHandle& node, Options options)
      : node_(node), options_(std::move(options)), active_(options_.file + ".active") {
    bag_.open(active_, rosbag::bagmode::Write);
  }

  // Records until shutdown. Throws rosbag::BagException when the bag can be written no longer.
  void run() {
    std::thread watcher([this] { watch(); });
    try {
      while (!over_) {
        std::this_thread::sleep_for(kWritePeriod);
        over_ = over_ || !ros::ok();
        write_what_waits();
      }
    } catch (...) {
      over_ = true;
      watcher.join();
      throw;
    }
    watcher.join();
    subscribers_.clear();
    write_what_waits();
    bag_.close();
    if (std::rename(active_.c_str(), options_.file.c_str()) != 0) {
      throw rosbag::BagIOException("cannot rename " + active_ + " to " + options_.file);
    }
    ROS_INFO("recorded %zu messages of %zu topics: %s", written_, topics_.size(), options_.file.c_str());
  }

 private:
  struct Waiting {
    std::string topic;
    Event event;
  };

  // Asks the master for topics again and again: its own thread, since the answer may be long in coming.
  void watch() {
    ros::WallTime next;
    while (!over_ && ros::ok()) {
      if (ros::WallTime::now() >= next) {
        next = ros::WallTime::now() + ros::WallDuration(kLookPeriodS);
        ros::master::V_TopicInfo known;
        if (ros::master::getTopics(known)) {
          for (const ros::master::TopicInfo& topic : known) {
            subscribe_if_wanted(topic.name);
          }
        }
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
  }

  void subscribe_if_wanted(const std::string& topic) {
    if (topics_.count(topic) != 0) {
      return;
    }
    bool wanted = false;
    for (const std::regex& pattern : options_.topics) {
      wanted = wanted || std::regex_match(topic, pattern);
    }
    if (!wanted) {
      return;
    }
    topics_.insert(topic);
    const auto limit = options_.most_hz.find(topic);
    const ros::Duration period(limit == options_.most_hz.end() ? 0.0 : 1.0 / limit->second);
    ros::SubscribeOptions options;
    options.topic = topic;
    options.queue_size = 0;
    options.md5sum = ros::message_traits::md5sum<Shape>();
    options.datatype = ros::message_traits::datatype<Shape>();
    options.transport_hints = ros::TransportHints().tcpNoDelay();
    options.callback_queue = &at_once_;
    options.helper = boost::make_shared<ros::SubscriptionCallbackHelperT<const Event&>>(
        [this, topic, period, last = ros::Time()](const Event& event) mutable {
          if (event.getReceiptTime() - last < period) {
            return;
          }
          last = event.getReceiptTime();
          keep(topic, event);
        });
    subscribers_.push_back(node_.subscribe(options));
  }

  void keep(const std::string& topic, const Event& event) {
    const std::lock_guard<std::mutex> lock(mutex_);
    const std::size_t bytes = event.getMessage()->size();
    if (waiting_bytes_ + bytes > kMostBytes) {
      ++dropped_;
      return;
    }
    waiting_bytes_ += bytes;
    waiting_.push_back({topic, event});
  }

  void write_what_waits() {
    std::vector<Waiting> batch;
    std::size_t dropped;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      batch.swap(waiting_);
      waiting_bytes_ = 0;
      dropped = dropped_;
    }
    for (const Waiting& one : batch) {
      bag_.write(one.topic, one.event);
    }
    written_ += batch.size();
    if (dropped != 0) {
      ROS_WARN_THROTTLE(kLogPeriodS, "the disk is too slow: %zu messages were not recorded so far", dropped);
    }
  }

  ros::NodeHandle node_;
  const Options options_;
  const std::string active_;  // name of the bag while it is being written, as rosbag has it
  rosbag::Bag bag_;
  AtOnce at_once_;
  std::atomic<bool> over_{false};
  std::size_t written_ = 0;

  // Touched by the watcher's thread only, and after its end.
  std::set<std::string> topics_;
  std::vector<ros::Subscriber> subscribers_;

  std::mutex mutex_;
  std::vector<Waiting> waiting_;
  std::size_t waiting_bytes_ = 0;
  std::size_t dropped_ = 0;
};

// roscpp handles SIGINT; process managers send SIGTERM, which shall end the bag in the same orderly way.
void on_terminate(int) {
  ros::requestShutdown();
}

int run_node(int argc, char** argv) {
  ros::init(argc, argv, "recorder");
  std::signal(SIGTERM, on_terminate);
  std::signal(SIGHUP, on_terminate);
  ros::NodeHandle node;  // outlives the try block: with the last node handle the logging ends too
  try {
    std::vector<std::string> arguments;
    ros::removeROSArgs(argc, argv, arguments);
    arguments.erase(arguments.begin());
    Recorder(node, parse(arguments)).run();
    return 0;
  } catch (const std::invalid_argument& error) {
    ROS_FATAL("recorder: %s", error.what());
  } catch (const rosbag::BagException& error) {
    ROS_FATAL("recorder: %s: is the folder there, and is there room on the disk?", error.what());
  }
  return 1;
}

}  // namespace
}  // namespace data_extraction

int main(int argc, char** argv) {
  return data_extraction::run_node(argc, argv);
}
