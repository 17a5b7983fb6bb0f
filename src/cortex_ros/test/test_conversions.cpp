// Frames to messages: units, lost markers, order.

#include <gtest/gtest.h>

#include <cmath>

#include "cortex_ros/conversions.hpp"

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

TEST(Conversions, EveryAxisBecomesMetres) {
  risc_msgs::Mocap_data message;
  fill_markers(two_bodies(), kMetresPerMillimetre, MissingMarkers::kNan, message);
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
  risc_msgs::Mocap_data message;
  fill_markers(two_bodies(), kMetresPerMillimetre, MissingMarkers::kNan, message);
  EXPECT_EQ(message.Obj[0].marker[2].x, 1000.5 * 0.001) << "single precision would give 1.0005000829696655";
  EXPECT_DOUBLE_EQ(message.Obj[0].marker[2].y, -0.05025);
}

TEST(Conversions, AnotherHostUnitIsScaled) {
  risc_msgs::Mocap_data message;
  fill_markers(two_bodies(), 25.4 * kMetresPerMillimetre, MissingMarkers::kNan, message);
  EXPECT_DOUBLE_EQ(message.Obj[0].marker[0].x, 25.4);
}

TEST(Conversions, LostMarkersStayInPlace) {
  risc_msgs::Mocap_data message;
  fill_markers(two_bodies(), kMetresPerMillimetre, MissingMarkers::kNan, message);
  EXPECT_TRUE(std::isnan(message.Obj[0].marker[1].x));
  EXPECT_TRUE(std::isnan(message.Obj[0].marker[1].y));
  EXPECT_TRUE(std::isnan(message.Obj[0].marker[1].z));
  fill_markers(two_bodies(), kMetresPerMillimetre, MissingMarkers::kLegacyValue, message);
  EXPECT_EQ(message.Obj[0].marker[1].x, 9999.999);
  EXPECT_EQ(message.Obj[0].marker[1].z, 9999.999);
  EXPECT_DOUBLE_EQ(message.Obj[0].marker[2].x, 1.0005);
}

TEST(Conversions, AReusedMessageKeepsNothing) {
  risc_msgs::Mocap_data message;
  fill_markers(two_bodies(), kMetresPerMillimetre, MissingMarkers::kNan, message);
  fill_markers(FrameOfData(), kMetresPerMillimetre, MissingMarkers::kNan, message);
  EXPECT_TRUE(message.Obj.empty());
}

TEST(Conversions, Stamps) {
  EXPECT_EQ(to_ros_time(Time{1700000000123456789}), ros::Time(1700000000u, 123456789u));
  EXPECT_EQ(to_ros_time(Time{-5}), ros::Time(0, 0));
}

}  // namespace
