#include "cortex_ros/conversions.hpp"

#include <algorithm>
#include <cmath>

namespace cortex_ros {

void fill_markers(const MocapFrame& frame, MissingMarkers missing, risc_msgs::Mocap_data& out) {
  out.Obj.resize(frame.bodies.size());
  for (std::size_t i = 0; i < frame.bodies.size(); ++i) {
    const MocapBody& body = frame.bodies[i];
    risc_msgs::Mocap_markers& object = out.Obj[i];
    object.name = body.name;
    object.residual = body.residual_m;
    object.marker.resize(body.markers.size());
    for (std::size_t k = 0; k < body.markers.size(); ++k) {
      Position position = body.markers[k];
      if (missing == MissingMarkers::kLegacyValue && std::isnan(position.x)) {
        position = {kLegacyMissingM, kLegacyMissingM, kLegacyMissingM};
      }
      object.marker[k].x = position.x;
      object.marker[k].y = position.y;
      object.marker[k].z = position.z;
    }
  }
}

ros::Time to_ros_time(Time wall) {
  ros::Time stamp;
  stamp.fromNSec(static_cast<std::uint64_t>(std::max(wall, Time{0}).count()));
  return stamp;
}

}  // namespace cortex_ros
