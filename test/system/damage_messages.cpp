// damage_messages IN OUT: a log of the same times and channels in which no message can be decoded:
// cut short, made longer, or of a type that does not belong on its channel.
#include <cstdio>
#include <vector>

#include "bus/log_file.hpp"

int main(int argc, char** argv) {
  if (argc != 3) {
    std::fprintf(stderr, "usage: damage_messages IN OUT\n");
    return 2;
  }
  gastronaut::LogReader reader(argv[1]);
  gastronaut::LogWriter writer(argv[2]);
  for (std::size_t i = 0; const auto event = reader.next(); ++i) {
    std::vector<std::uint8_t> payload(event->payload.begin(), event->payload.end());
    switch (i % 3) {
      case 0:
        payload.resize(payload.size() / 2);
        break;
      case 1:
        payload.push_back(0);
        break;
      default:
        payload[0] = static_cast<std::uint8_t>(~payload[0]);  // the fingerprint
    }
    writer.write(event->channel, payload, event->log_utime);
  }
  writer.close();
  return 0;
}
