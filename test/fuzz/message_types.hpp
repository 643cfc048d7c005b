// Every message type that travels by itself, by number.
#pragma once

#include <cstddef>
#include <tuple>

#include "bus/wire.hpp"

namespace gastronaut {

using MessageTypes =
    std::tuple<capsule_state_t, coil_currents_t, depth_image_t, hall_array_t, image_t,
               magnetic_pose_t, map_deformation_t, map_surfels_t, occupancy_t, pose_t,
               process_status_t, rig_config_t, rigid_transform_t, visual_pose_t>;
constexpr std::size_t kMessageTypes = std::tuple_size_v<MessageTypes>;

// visit(Message{}) for type number `type`.
template <std::size_t kNumber = 0, class Visitor>
void visit_message_type(std::size_t type, const Visitor& visit) {
  if constexpr (kNumber < kMessageTypes) {
    if (type == kNumber) {
      visit(std::tuple_element_t<kNumber, MessageTypes>{});
    } else {
      visit_message_type<kNumber + 1>(type, visit);
    }
  }
}

}  // namespace gastronaut
