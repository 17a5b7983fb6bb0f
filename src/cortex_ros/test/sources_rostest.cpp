// A new vendor is one file and one YAML: frames of sources/toy.{cpp,yaml} through all of stream_markers.

#include <diagnostic_msgs/DiagnosticArray.h>
#include <gtest/gtest.h>
#include <risc_maap_msgs/MocapTime.h>
#include <risc_maap_msgs/UnidentifiedMarkers.h>

#include <chrono>
#include <cmath>
#include <map>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>
#include <vector>

#include "cortex_ros/mocap_publisher.hpp"
#include "cortex_ros/sources/cortex.hpp"

namespace {

using namespace cortex_ros;  // NOLINT
using diagnostic_msgs::DiagnosticStatus;

constexpr std::chrono::seconds kPatience{30};

// The YAML that the launch file has loaded under ~name.
XmlRpc::XmlRpcValue yaml(const std::string& name) {
  XmlRpc::XmlRpcValue values;
  if (!ros::param::get("~" + name, values)) {
    throw std::runtime_error("no parameters ~" + name);
  }
  return values;
}

template <typename Message>
class Inbox {
 public:
  Inbox(ros::NodeHandle& node, const std::string& topic)
      : subscriber_(
            node.subscribe<Message>(topic, 1000, [this](const boost::shared_ptr<const Message>& message) {
              const std::lock_guard<std::mutex> lock(mutex_);
              messages_.push_back(*message);
            })) {}

  std::vector<Message> messages() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return messages_;
  }

  // Waits for `count` messages and returns them; after kPatience returns those that came.
  std::vector<Message> wait_for(std::size_t count) const {
    const auto deadline = std::chrono::steady_clock::now() + kPatience;
    while (messages().size() < count && std::chrono::steady_clock::now() < deadline) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return messages();
  }

 private:
  mutable std::mutex mutex_;
  std::vector<Message> messages_;
  ros::Subscriber subscriber_;
};

class Sources : public testing::Test {
 protected:
  Sources() { spinner_.start(); }

  // Waits for the first status of the node whose message contains the text.
  DiagnosticStatus status(const std::string& text) const {
    const auto deadline = std::chrono::steady_clock::now() + kPatience;
    while (std::chrono::steady_clock::now() < deadline) {
      for (const auto& message : diagnostics_.messages()) {
        if (message.status[0].message.find(text) != std::string::npos) {
          return message.status[0];
        }
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    throw std::runtime_error("no status with: " + text);
  }

  ros::NodeHandle node_;
  ros::AsyncSpinner spinner_{1};
  Inbox<risc_msgs::Mocap_data> markers_{node_, "mocap_data"};
  Inbox<risc_maap_msgs::MocapTime> times_{node_, "mocap_time"};
  Inbox<risc_maap_msgs::UnidentifiedMarkers> unidentified_{node_, "mocap_unidentified"};
  Inbox<diagnostic_msgs::DiagnosticArray> diagnostics_{node_, "/diagnostics"};
};

TEST_F(Sources, AToyIsOneFileAndOneYaml) {
  Parameters parameters(yaml("toy"));
  parameters.set("source", "toy");
  const MocapPublisher publisher(node_, parameters);
  EXPECT_TRUE(parameters.unread().empty());

  const auto frames = markers_.wait_for(50);
  ASSERT_GE(frames.size(), 50u);
  for (const auto& frame : frames) {
    EXPECT_EQ(frame.header.frame_id, "cortex");
    ASSERT_EQ(frame.Obj.size(), 1u);
    EXPECT_EQ(frame.Obj[0].name, "wooden_duck");
    EXPECT_EQ(frame.Obj[0].residual, 0.002);
    ASSERT_EQ(frame.Obj[0].marker.size(), 2u);
    EXPECT_EQ(frame.Obj[0].marker[0].y, 2.0);
    EXPECT_TRUE(std::isnan(frame.Obj[0].marker[1].x));
  }
  for (std::size_t i = 1; i < frames.size(); ++i) {
    EXPECT_GT(frames[i].header.stamp, frames[i - 1].header.stamp);
  }

  const auto loose = unidentified_.wait_for(50);
  ASSERT_GE(loose.size(), 50u);
  std::set<ros::Time> stamps;
  for (const auto& frame : markers_.messages()) {
    stamps.insert(frame.header.stamp);
  }
  EXPECT_EQ(loose[20].positions, (std::vector<double>{0.0, 0.0, 1.0}));
  EXPECT_EQ(loose[20].header.frame_id, "cortex");
  EXPECT_EQ(stamps.count(loose[20].header.stamp), 1u);

  std::set<std::int32_t> numbers;
  for (const auto& time : times_.wait_for(50)) {
    EXPECT_TRUE(numbers.insert(time.frame).second) << "came twice: " << time.frame;
    EXPECT_EQ(time.delay, 0.004);
    EXPECT_GE((time.receipt - time.header.stamp).toSec(), 0.004 - 1e-6) << "exposure is before receipt";
  }

  const DiagnosticStatus status = this->status("frames lost");
  EXPECT_EQ(status.level, DiagnosticStatus::WARN);
  EXPECT_NE(status.message.find("a toy sees nothing"), std::string::npos) << status.message;
  std::map<std::string, std::string> values;
  for (const auto& value : status.values) {
    values[value.key] = value.value;
  }
  EXPECT_EQ(values["host"], "toy box");
  EXPECT_EQ(values["mode"], "spring");
  EXPECT_EQ(values["springs"], "7");
  EXPECT_EQ(values["unidentified markers"], "1");
  EXPECT_EQ(values["reported delay [s]"], "0.004000");
  EXPECT_GT(std::stoi(values["lost"]), 0);
  EXPECT_NEAR(std::stoi(values["duplicates"]), std::stoi(values["frames"]), 1);
}

TEST_F(Sources, AnotherAxisUpIsRefusedWhoeverSaysSo) {
  Parameters parameters(yaml("toy"));
  parameters.set("source", "toy");
  parameters.set("up_axis", "y");
  const MocapPublisher publisher(node_, parameters);
  EXPECT_EQ(status("up axis is y: nothing is published").level, DiagnosticStatus::ERROR);
  EXPECT_TRUE(markers_.messages().empty());
}

TEST_F(Sources, AnUnknownOneIsRefusedWithTheNamesOfThoseThatAreKnown) {
  Parameters parameters(XmlRpc::XmlRpcValue{});
  parameters.set("source", "sundial");
  try {
    const MocapPublisher publisher(node_, parameters);
    FAIL() << "accepted";
  } catch (const std::invalid_argument& error) {
    for (const char* fact : {"source", "'sundial'", "cortex, toy"}) {
      EXPECT_NE(std::string(error.what()).find(fact), std::string::npos) << error.what();
    }
  }
}

TEST_F(Sources, TheYamlOfCortexHoldsTheDefaults) {
  Parameters from_yaml(yaml("cortex"));
  from_yaml.set("host", "cortex-pc");
  const ClientOptions found = read_client_options(from_yaml);
  EXPECT_TRUE(from_yaml.unread().empty());
  const ClientOptions built_in;
  EXPECT_EQ(found.local_address, built_in.local_address);
  EXPECT_EQ(found.command_port, built_in.command_port);
  EXPECT_EQ(found.stream_group, built_in.stream_group);
  EXPECT_EQ(found.stream_port, built_in.stream_port);
  EXPECT_EQ(found.mode, built_in.mode);
  EXPECT_EQ(found.live_on_start, built_in.live_on_start);
  EXPECT_EQ(found.pause_on_exit, built_in.pause_on_exit);
  EXPECT_EQ(found.frame_rate_hz, built_in.frame_rate_hz);
}

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  ros::init(argc, argv, "sources_test");
  return RUN_ALL_TESTS();
}
