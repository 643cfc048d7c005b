// compare_logs A B CHANNEL...: whether both logs hold the same payloads in the same order on each
// channel, and something at all. Says where they part.
#include <cstdio>
#include <cstring>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "bus/log_file.hpp"

namespace {

using Payloads = std::map<std::string, std::vector<std::vector<std::uint8_t>>>;

Payloads read(const char* path, const std::set<std::string>& channels) {
  Payloads payloads;
  gastronaut::LogReader reader(path);
  while (const auto event = reader.next()) {
    if (channels.contains(event->channel)) {
      payloads[event->channel].emplace_back(event->payload.begin(), event->payload.end());
    }
  }
  return payloads;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fprintf(stderr, "usage: compare_logs A B CHANNEL...\n");
    return 2;
  }
  const std::set<std::string> channels(argv + 3, argv + argc);
  Payloads a = read(argv[1], channels);
  Payloads b = read(argv[2], channels);
  int different = 0;
  for (const std::string& channel : channels) {
    const auto& left = a[channel];
    const auto& right = b[channel];
    std::size_t i = 0;
    while (i < left.size() && i < right.size() && left[i] == right[i]) ++i;
    const bool same = i == left.size() && i == right.size() && !left.empty();
    std::printf("%s: %zu against %zu messages, the first %zu are the same%s\n", channel.c_str(),
                left.size(), right.size(), i, same ? "" : ": DIFFERENT");
    different += same ? 0 : 1;
  }
  return different == 0 ? 0 : 1;
}
