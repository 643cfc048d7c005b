// count_messages LOG CHANNEL AT_LEAST: exit status 0 when the log holds that many.
#include <cstdio>
#include <cstdlib>
#include <string>

#include "bus/log_file.hpp"

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fprintf(stderr, "usage: count_messages LOG CHANNEL AT_LEAST\n");
    return 2;
  }
  int count = 0;
  gastronaut::LogReader reader(argv[1]);
  while (const auto event = reader.next()) count += event->channel == argv[2] ? 1 : 0;
  std::printf("%d\n", count);
  return count >= std::atoi(argv[3]) ? 0 : 1;
}
