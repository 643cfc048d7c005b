// RIG_CONFIG: the whole effective configuration, so that a log explains itself.
#pragma once

#include "configuration/rig_configuration.hpp"
#include "gastronaut/rig_config_t.hpp"

namespace gastronaut {

rig_config_t rig_config_message(const RigConfiguration& configuration, std::int64_t utime);

}  // namespace gastronaut
