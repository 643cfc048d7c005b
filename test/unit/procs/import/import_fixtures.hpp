// What the tests of import share: a folder of their own, collected issues, written files.
#pragma once

#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "bus/log_file.hpp"
#include "import/issues.hpp"

namespace gastronaut {

class ScratchFolder {
 public:
  ScratchFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "import_test_XXXXXX").string();
    path_ = mkdtemp(pattern.data());
  }
  ~ScratchFolder() { std::filesystem::remove_all(path_); }
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  std::string operator/(const std::string& name) const { return path_ + "/" + name; }
  const std::string& path() const { return path_; }
  std::string write(const std::string& name, const std::string& text) const {
    std::filesystem::create_directories(std::filesystem::path(*this / name).parent_path());
    std::ofstream(*this / name, std::ios::binary) << text;
    return *this / name;
  }

 private:
  std::string path_;
};

struct CollectedIssues {
  std::vector<std::string> list;
  Issues issues{[this](const std::string& what, std::size_t) { list.push_back(what); }};
};

// The events of a log; the log must be undamaged.
struct LoggedEvent {
  std::int64_t utime = 0;
  std::string channel;
  std::vector<std::uint8_t> payload;
};

inline std::vector<LoggedEvent> read_log(const std::string& path) {
  LogReader reader(path);
  std::vector<LoggedEvent> events;
  while (const auto event = reader.next()) {
    events.push_back(
        {event->log_utime, event->channel, {event->payload.begin(), event->payload.end()}});
  }
  if (!reader.damage().empty()) throw std::runtime_error(reader.damage());
  return events;
}

template <class Message>
std::vector<Message> read_channel(const std::vector<LoggedEvent>& events,
                                  const std::string& channel) {
  std::vector<Message> messages;
  for (const LoggedEvent& event : events) {
    if (event.channel != channel) continue;
    Message& message = messages.emplace_back();
    if (decode_message(event.payload, message) != DecodeResult::kOk ||
        message.utime != event.utime) {
      throw std::runtime_error(channel + ": a message is not what its channel says");
    }
  }
  return messages;
}

}  // namespace gastronaut
