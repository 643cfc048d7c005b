// A file with any bytes as a log: events up to the damage, and the damage named.
#include <sys/mman.h>
#include <unistd.h>

#include <string>

#include "bus/log_file.hpp"
#include "fuzz_check.hpp"

using namespace gastronaut;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  static const int file = memfd_create("log", 0);
  promise(file >= 0 && ftruncate(file, 0) == 0 &&
              pwrite(file, data, size, 0) == static_cast<ssize_t>(size),
          "the host can hold a file in memory");
  LogReader reader("/proc/self/fd/" + std::to_string(file));
  std::uint64_t offset = 0;
  while (const auto event = reader.next()) {
    promise(reader.offset() > offset + event->channel.size() + event->payload.size(),
            "an event takes its header, its channel and its payload");
    offset = reader.offset();
    promise(offset <= size, "an event lies within the file");
    promise(std::equal(event->payload.begin(), event->payload.end(),
                       data + offset - event->payload.size()),
            "a payload is the file's bytes");
  }
  promise(reader.damage().empty() == (reader.offset() == size),
          "what is not read to the end is damaged, and says so");
  return 0;
}
