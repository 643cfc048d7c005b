// Any text as a rig's configuration, and after a zero byte as a setting: a configuration that
// writes and reads back as itself, or a ConfigurationError, nothing else.
#include <string>

#include "configuration/rig_configuration.hpp"
#include "fuzz_check.hpp"

using namespace gastronaut;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(data, data + size);
  const std::size_t zero = text.find('\0');
  std::vector<std::string> settings;
  if (zero != std::string::npos) settings.push_back(text.substr(zero + 1));
  try {
    const RigConfiguration rig =
        parse_rig_configuration(text.substr(0, zero), "rig.yaml", settings);
    const std::string written = write_configuration(rig);
    try {
      promise(write_configuration(parse_rig_configuration(written, "again")) == written,
              "a configuration survives RIG_CONFIG");
    } catch (const ConfigurationError& error) {
      promise(false, error.what());
    }
  } catch (const ConfigurationError&) {
  }
  return 0;
}
