#include "process/rig_config_message.hpp"

#include "process/version.hpp"

namespace gastronaut {

rig_config_t rig_config_message(const RigConfiguration& configuration, std::int64_t utime) {
  rig_config_t message;
  message.utime = utime;
  message.name = configuration.name;
  message.yaml = write_configuration(configuration);
  message.code_version = code_version();
  return message;
}

}  // namespace gastronaut
