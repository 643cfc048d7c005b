// print_rig_config LOG: the first RIG_CONFIG's YAML, for live processes that are to run as the
// log's did.
#include <cstdio>

#include "bus/log_file.hpp"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: print_rig_config LOG\n");
    return 2;
  }
  gastronaut::LogReader reader(argv[1]);
  while (const auto event = reader.next()) {
    gastronaut::rig_config_t message;
    if (gastronaut::decode_message(event->payload, message) == gastronaut::DecodeResult::kOk) {
      std::fputs(message.yaml.c_str(), stdout);
      return 0;
    }
  }
  std::fprintf(stderr, "%s: no RIG_CONFIG\n", argv[1]);
  return 1;
}
