// Node MocapStates (executable stream_markers): motion capture -> mocap_data, mocap_time and
// mocap_unidentified. Wiring only.

#include <ros/ros.h>

#include <csignal>
#include <stdexcept>

#include "cortex_ros/mocap_publisher.hpp"

namespace {

// Reads the private parameters, and the arguments of the original program: local address and host address.
cortex_ros::Parameters read_parameters(int argc, char** argv) {
  XmlRpc::XmlRpcValue values;
  ros::param::get(ros::this_node::getName(), values);
  cortex_ros::Parameters parameters(values);
  if (argc > 3) {
    throw std::invalid_argument("usage: stream_markers [local address [host address]] (and _param:=value)");
  }
  if (argc > 1) {
    parameters.set("local_address", argv[1]);
  }
  if (argc > 2) {
    parameters.set("host", argv[2]);
  }
  return parameters;
}

// roscpp handles SIGINT; process managers send SIGTERM, which must shut the node down in the same orderly
// way.
void on_terminate(int) {
  ros::requestShutdown();
}

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "MocapStates");
  std::signal(SIGTERM, on_terminate);
  ros::NodeHandle node;  // outlives the try block: logging stops with the last node handle
  try {
    cortex_ros::Parameters parameters = read_parameters(argc, argv);
    cortex_ros::MocapPublisher publisher(node, parameters);  // not const: its threads change it
    ros::spin();
    return 0;
  } catch (const std::exception& error) {
    ROS_FATAL("stream_markers: %s", error.what());
    return 1;
  }
}
