// Cortex frames to source-independent frames, and these to messages: units, lost markers, order.

#include <gtest/gtest.h>

#include <cmath>

#include "cortex_ros/mocap_publisher.hpp"
#include "cortex_ros/sources/cortex.hpp"

namespace {

using namespace cortex_ros;  // NOLINT

FrameOfData two_bodies() {
  FrameOfData frame;
  frame.bodies.resize(2);
  frame.bodies[0].name = "fluffy_II";
  frame.bodies[0].markers = {{1000.0f, 2000.0f, 3000.0f},
                             {kMissingCoordinate, kMissingCoordinate, kMissingCoordinate},
                             {1000.5f, -50.25f, 0.0f}};
  frame.bodies[1].name = "Landmark_A";
  return frame;
}

risc_msgs::Mocap_data to_message(const FrameOfData& frame, double metres_per_unit, bool missing_as_nan) {
  MocapFrame neutral;
  to_mocap_frame(frame, metres_per_unit, neutral);
  risc_msgs::Mocap_data message;
  fill_markers(neutral, missing_as_nan, message);
  return message;
}

TEST(Conversions, EveryAxisBecomesMetres) {
  const risc_msgs::Mocap_data message = to_message(two_bodies(), kMetresPerMillimetre, true);
  ASSERT_EQ(message.Obj.size(), 2u);
  EXPECT_EQ(message.Obj[0].name, "fluffy_II");
  EXPECT_EQ(message.Obj[0].residual, 0.0);
  ASSERT_EQ(message.Obj[0].marker.size(), 3u);
  EXPECT_DOUBLE_EQ(message.Obj[0].marker[0].x, 1.0);
  EXPECT_DOUBLE_EQ(message.Obj[0].marker[0].y, 2.0);
  EXPECT_DOUBLE_EQ(message.Obj[0].marker[0].z, 3.0);
  EXPECT_EQ(message.Obj[1].name, "Landmark_A");
  EXPECT_TRUE(message.Obj[1].marker.empty());
}

TEST(Conversions, TheProductIsADoubleOne) {
  const risc_msgs::Mocap_data message = to_message(two_bodies(), kMetresPerMillimetre, true);
  EXPECT_EQ(message.Obj[0].marker[2].x, 1000.5 * 0.001) << "single precision would give 1.0005000829696655";
  EXPECT_DOUBLE_EQ(message.Obj[0].marker[2].y, -0.05025);
}

TEST(Conversions, AnotherHostUnitIsScaled) {
  const risc_msgs::Mocap_data message = to_message(two_bodies(), 25.4 * kMetresPerMillimetre, true);
  EXPECT_DOUBLE_EQ(message.Obj[0].marker[0].x, 25.4);
}

TEST(Conversions, LostMarkersStayInPlace) {
  const risc_msgs::Mocap_data message = to_message(two_bodies(), kMetresPerMillimetre, true);
  EXPECT_TRUE(std::isnan(message.Obj[0].marker[1].x));
  EXPECT_TRUE(std::isnan(message.Obj[0].marker[1].y));
  EXPECT_TRUE(std::isnan(message.Obj[0].marker[1].z));
  const risc_msgs::Mocap_data legacy = to_message(two_bodies(), kMetresPerMillimetre, false);
  EXPECT_EQ(legacy.Obj[0].marker[1].x, 9999.999);
  EXPECT_EQ(legacy.Obj[0].marker[1].z, 9999.999);
  EXPECT_DOUBLE_EQ(legacy.Obj[0].marker[2].x, 1.0005);
}

TEST(Conversions, AReusedMessageKeepsNothing) {
  MocapFrame frame;
  risc_msgs::Mocap_data message;
  to_mocap_frame(two_bodies(), kMetresPerMillimetre, frame);
  fill_markers(frame, true, message);
  to_mocap_frame(FrameOfData(), kMetresPerMillimetre, frame);
  fill_markers(frame, true, message);
  EXPECT_TRUE(message.Obj.empty());
  EXPECT_TRUE(frame.unidentified.empty());
}

TEST(Conversions, NumberDelayAndUnidentifiedMarkersAreKept) {
  FrameOfData frame = two_bodies();
  frame.frame = 77;
  frame.unidentified = {{1.0f, 2.0f, 3.0f}};
  MocapFrame out;
  to_mocap_frame(frame, kMetresPerMillimetre, out);
  EXPECT_EQ(out.number, 77);
  EXPECT_FALSE(out.delay_s.has_value());
  ASSERT_EQ(out.unidentified.size(), 1u);
  EXPECT_DOUBLE_EQ(out.unidentified[0].z, 0.003);
  frame.delay_s = 0.25f;
  to_mocap_frame(frame, kMetresPerMillimetre, out);
  EXPECT_EQ(out.delay_s, 0.25);
}

TEST(Conversions, Stamps) {
  EXPECT_EQ(to_ros_time(Time{1700000000123456789}), ros::Time(1700000000u, 123456789u));
  EXPECT_EQ(to_ros_time(Time{-5}), ros::Time(0, 0));
}

}  // namespace
