#include "cortex_ros/conversions.hpp"

#include <algorithm>
#include <limits>

namespace cortex_ros {
namespace {

void fill_marker(const Marker& marker, double metres_per_unit, double missing_m,
                 risc_msgs::Mocap_marker& out) {
  const bool missing = marker.missing();
  out.x = missing ? missing_m : static_cast<double>(marker.x) * metres_per_unit;
  out.y = missing ? missing_m : static_cast<double>(marker.y) * metres_per_unit;
  out.z = missing ? missing_m : static_cast<double>(marker.z) * metres_per_unit;
}

}  // namespace

void fill_markers(const FrameOfData& frame, double metres_per_unit, MissingMarkers missing,
                  risc_msgs::Mocap_data& out) {
  const double missing_m =
      missing == MissingMarkers::kNan ? std::numeric_limits<double>::quiet_NaN() : kLegacyMissingM;
  out.Obj.resize(frame.bodies.size());
  for (std::size_t i = 0; i < frame.bodies.size(); ++i) {
    const Body& body = frame.bodies[i];
    risc_msgs::Mocap_markers& object = out.Obj[i];
    object.name = body.name;
    object.residual = 0.0;  // not on the wire
    object.marker.resize(body.markers.size());
    for (std::size_t k = 0; k < body.markers.size(); ++k) {
      fill_marker(body.markers[k], metres_per_unit, missing_m, object.marker[k]);
    }
  }
}

ros::Time to_ros_time(Time wall) {
  ros::Time stamp;
  stamp.fromNSec(static_cast<std::uint64_t>(std::max(wall, Time{0}).count()));
  return stamp;
}

}  // namespace cortex_ros
