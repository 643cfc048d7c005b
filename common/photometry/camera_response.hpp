// From a camera's 8-bit levels to linear light.
#pragma once

#include <array>

#include "configuration/rig_configuration.hpp"

namespace gastronaut {

// Linear light, full scale being 1, of the levels 0 to 255: camera.response where it was
// calibrated, else (level / 255)^gamma. Strictly increasing from 0 to 1.
std::array<float, 256> linear_light_of_levels(const CameraConfiguration& camera);

}  // namespace gastronaut
