// LCM logs, read with suspicion and written with care.
#pragma once

#include <cstdint>
#include <cstdio>
#include <lcm/lcm-cpp.hpp>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bus/wire.hpp"

namespace gastronaut {

// Reads events up to the end or the first damage, which it reports with its offset. lcm::LogFile
// cannot serve here: it skips over damage in silence, throws away the good event before it, and
// allocates whatever length a damaged header asks for.
class LogReader {
 public:
  struct Event {
    std::int64_t log_utime = 0;  // when it was recorded, microseconds
    std::string channel;
    Bytes payload;  // valid until the next call
  };

  // Throws std::runtime_error when the file cannot be opened.
  explicit LogReader(const std::string& path);

  // Nothing at the end, or where the log is damaged from here on.
  std::optional<Event> next();
  // After the last event: what is wrong and at which offset; empty when the log ended well.
  const std::string& damage() const { return damage_; }
  std::uint64_t offset() const { return offset_; }
  std::uint64_t size() const { return size_; }

 private:
  std::string path_;
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_;
  std::vector<std::uint8_t> payload_;
  std::uint64_t offset_ = 0;
  std::uint64_t size_ = 0;
  std::string damage_;
};

// Writes FILE.partial and renames it to FILE in close(), so that a log under its own name is whole.
// A .partial left by a killed process is a readable log up to its end.
class LogWriter {
 public:
  // Throws std::runtime_error when the file cannot be made.
  explicit LogWriter(const std::string& path);
  ~LogWriter();
  LogWriter(const LogWriter&) = delete;
  LogWriter& operator=(const LogWriter&) = delete;

  // Throws std::runtime_error (disk full and the like).
  void write(const std::string& channel, Bytes payload, std::int64_t log_utime);
  template <class Message>
  void write(const std::string& channel, const Message& message) {
    write(channel, encode_message(message), message.utime);
  }
  // Flushes, checks and renames. Throws as write does. Without it the .partial stays.
  void close();

 private:
  [[noreturn]] void fail(const std::string& action) const;

  std::string path_;
  std::string partial_path_;
  std::unique_ptr<lcm::LogFile> file_;
};

}  // namespace gastronaut
