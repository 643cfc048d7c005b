// compare_readings SENT RECORDED: every reading and every measurement of the currents that is in
// SENT must be in RECORDED once, with the same number, the same bits in its field (currents: the
// nearest count of the CAN database) and the same status, and no other. Also how late they were
// recorded.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <gastronaut/coil_currents_t.hpp>
#include <gastronaut/hall_array_t.hpp>
#include <map>
#include <stdexcept>
#include <vector>

#include "bus/log_file.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

constexpr double kCurrentCount = 1e-5;  // ampere, coil*_current in config/hall_array*.dbc

struct Recording {
  std::map<std::int32_t, hall_array_t> readings;
  std::map<std::int32_t, coil_currents_t> currents;
  std::vector<double> delays;  // seconds from a reading's utime to its being recorded
  int twice = 0;
};

template <class Message>
Message decode(const LogReader::Event& event) {
  Message message;
  if (decode_message(event.payload, message) != DecodeResult::kOk) {
    throw std::runtime_error("a damaged message on " + event.channel);
  }
  return message;
}

Recording read(const char* path) {
  Recording recording;
  LogReader log(path);
  while (const auto event = log.next()) {
    if (event->channel == channel::kHallArray) {
      auto message = decode<hall_array_t>(*event);
      recording.delays.push_back(static_cast<double>(event->log_utime - message.utime) * 1e-6);
      const std::int32_t seq = message.seq;
      recording.twice += recording.readings.emplace(seq, std::move(message)).second ? 0 : 1;
    } else if (event->channel == channel::kCoilCurrents) {
      auto message = decode<coil_currents_t>(*event);
      const std::int32_t seq = message.seq;
      recording.twice += recording.currents.emplace(seq, std::move(message)).second ? 0 : 1;
    }
  }
  if (!log.damage().empty()) throw std::runtime_error(log.damage());
  return recording;
}

bool same(const hall_array_t& sent, const hall_array_t& recorded) {
  return sent.field == recorded.field && sent.status == recorded.status;
}

bool same(const coil_currents_t& sent, const coil_currents_t& recorded) {
  if (sent.current.size() != recorded.current.size()) return false;
  for (std::size_t coil = 0; coil < sent.current.size(); ++coil) {
    const double counts = std::round(static_cast<double>(sent.current[coil]) / kCurrentCount);
    if (static_cast<float>(counts * kCurrentCount) != recorded.current[coil]) return false;
  }
  return true;
}

template <class Message>
bool compare(const char* what, const std::map<std::int32_t, Message>& sent,
             const std::map<std::int32_t, Message>& recorded) {
  int lost = 0;
  int different = 0;
  for (const auto& [seq, message] : sent) {
    const auto found = recorded.find(seq);
    if (found == recorded.end()) {
      ++lost;
    } else if (!same(message, found->second)) {
      ++different;
    }
  }
  const auto foreign = static_cast<long>(recorded.size()) - (static_cast<long>(sent.size()) - lost);
  std::printf("%s: %zu sent, %d lost, %d different, %ld never sent\n", what, sent.size(), lost,
              different, foreign);
  return !sent.empty() && lost == 0 && different == 0 && foreign == 0;
}

int run(const char* sent_path, const char* recorded_path) {
  const Recording sent = read(sent_path);
  Recording recorded = read(recorded_path);
  bool good = compare("readings", sent.readings, recorded.readings);
  good = compare("currents", sent.currents, recorded.currents) && good;
  if (recorded.twice > 0) std::printf("%d messages came twice\n", recorded.twice);
  std::vector<double>& delays = recorded.delays;
  std::sort(delays.begin(), delays.end());
  if (!delays.empty()) {
    const auto ms = [&](double quantile) {
      return 1e3 *
             delays[static_cast<std::size_t>(quantile * static_cast<double>(delays.size() - 1))];
    };
    std::printf(
        "ms from the kernel's time of the first frame to the recording: median %.2f, p90 %.2f, "
        "p99 %.2f, p99.9 %.2f, max %.2f\n",
        ms(0.5), ms(0.9), ms(0.99), ms(0.999), ms(1));
  }
  return good && recorded.twice == 0 ? 0 : 1;
}

}  // namespace
}  // namespace gastronaut

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  try {
    return gastronaut::run(argv[1], argv[2]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "compare_readings: %s\n", error.what());
    return 1;
  }
}
