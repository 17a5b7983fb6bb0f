// Parameters of the node, without a parameter server.

#include <gtest/gtest.h>

#include <stdexcept>

#include "cortex_ros/parameters.hpp"

namespace {

using namespace cortex_ros;  // NOLINT

TEST(Parameters, AreReadByTypeAndThoseOfALaunchFileCount) {
  XmlRpc::XmlRpcValue values;
  values["mocap"]["host"] = "10.0.0.1";
  values["mocap"]["command_port"] = 70000;
  values["host"] = "10.0.0.2";
  values["frame_rate"] = 100;
  values["misspelt"] = true;
  cortex_ros::Parameters parameters(values);
  std::string host;
  parameters.read("host", host);
  EXPECT_EQ(host, "10.0.0.2") << "its own wins";
  double rate_hz = 0.0;
  parameters.read("frame_rate", rate_hz);
  EXPECT_EQ(rate_hz, 100.0);
  bool flag = false;
  EXPECT_THROW(parameters.read("host", flag), std::invalid_argument);
  std::uint16_t port = 1;
  EXPECT_THROW(parameters.read("command_port", port), std::invalid_argument);
  EXPECT_EQ(parameters.unread(), std::vector<std::string>{"misspelt"});
}

}  // namespace
