#include "bus/log_file.hpp"

#include <sys/stat.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <stdexcept>

namespace gastronaut {
namespace {

// The event header of LCM's log format: sync word, event number, timestamp, lengths; big endian.
constexpr std::size_t kHeaderSize = 28;
constexpr std::uint32_t kSyncWord = 0xEDA1DA01;
constexpr std::size_t kTimestampAt = 12;
constexpr std::size_t kChannelLengthAt = 20;
constexpr std::size_t kDataLengthAt = 24;
constexpr std::uint32_t kLongestChannel = 999;  // liblcm refuses longer names

std::uint32_t big_endian(const unsigned char* bytes) {
  return (std::uint32_t{bytes[0]} << 24) | (std::uint32_t{bytes[1]} << 16) |
         (std::uint32_t{bytes[2]} << 8) | bytes[3];
}

}  // namespace

LogReader::LogReader(const std::string& path)
    : path_(path), file_(std::fopen(path.c_str(), "rb"), &std::fclose) {
  struct stat status {};
  if (!file_ || fstat(fileno(file_.get()), &status) != 0) {
    throw std::runtime_error(path + ": cannot be opened: " + std::strerror(errno));
  }
  if (!S_ISREG(status.st_mode)) throw std::runtime_error(path + ": is not a regular file");
  size_ = static_cast<std::uint64_t>(status.st_size);
}

std::optional<LogReader::Event> LogReader::next() {
  if (!damage_.empty() || offset_ == size_) return std::nullopt;
  const auto damaged = [this](const std::string& what) {
    damage_ = path_ + ": damaged at offset " + std::to_string(offset_) + " of " +
              std::to_string(size_) + ": " + what;
    return std::nullopt;
  };
  std::array<unsigned char, kHeaderSize> header{};
  if (std::fread(header.data(), 1, kHeaderSize, file_.get()) != kHeaderSize) {
    return damaged("the last event is cut off");
  }
  if (big_endian(header.data()) != kSyncWord) return damaged("no event starts here");
  const std::uint32_t channel_length = big_endian(&header[kChannelLengthAt]);
  const std::uint32_t data_length = big_endian(&header[kDataLengthAt]);
  if (channel_length == 0 || channel_length > kLongestChannel) {
    return damaged("impossible channel name length " + std::to_string(channel_length));
  }
  const std::uint64_t end = offset_ + kHeaderSize + channel_length + data_length;
  if (end > size_) return damaged("the event reaches beyond the end of the file");
  Event event;
  event.log_utime =
      static_cast<std::int64_t>((std::uint64_t{big_endian(&header[kTimestampAt])} << 32) |
                                big_endian(&header[kTimestampAt + 4]));
  event.channel.resize(channel_length);
  payload_.resize(data_length);
  if (std::fread(event.channel.data(), 1, channel_length, file_.get()) != channel_length ||
      std::fread(payload_.data(), 1, data_length, file_.get()) != data_length) {
    return damaged("the event cannot be read");
  }
  event.payload = payload_;
  offset_ = end;
  return event;
}

LogWriter::LogWriter(const std::string& path) : path_(path), partial_path_(path + ".partial") {
  file_ = std::make_unique<lcm::LogFile>(partial_path_, "w");
  if (!file_->good()) fail("made");
}

LogWriter::~LogWriter() = default;

void LogWriter::fail(const std::string& action) const {
  const int error = errno;
  throw std::runtime_error(partial_path_ + ": cannot be " + action + ": " +
                           (error != 0 ? std::strerror(error) : "unknown error"));
}

void LogWriter::write(const std::string& channel, Bytes payload, std::int64_t log_utime) {
  lcm::LogEvent event{};
  event.timestamp = log_utime;
  event.channel = channel;
  event.datalen = static_cast<std::int32_t>(payload.size());
  event.data = const_cast<std::uint8_t*>(payload.data());  // LogFile takes no const
  errno = 0;
  if (file_->writeEvent(&event) != 0) fail("written");
}

void LogWriter::close() {
  errno = 0;
  if (std::fflush(file_->getFilePtr()) != 0 || std::ferror(file_->getFilePtr()) != 0) {
    fail("written");
  }
  file_.reset();
  if (std::rename(partial_path_.c_str(), path_.c_str()) != 0) fail("renamed to " + path_);
}

}  // namespace gastronaut
