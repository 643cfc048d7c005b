// live_latency LOG: how long after a measurement what was made of it came, in a recording of live
// processes by lcm-logger: from the arrival of the raw message to that of the derived one of the
// same utime.
#include <algorithm>
#include <cstdio>
#include <map>
#include <string>
#include <vector>

#include "bus/log_file.hpp"
#include "bus/wire.hpp"
#include "gastronaut/capsule_state_t.hpp"
#include "gastronaut/depth_image_t.hpp"
#include "gastronaut/hall_array_t.hpp"
#include "gastronaut/image_t.hpp"
#include "gastronaut/magnetic_pose_t.hpp"
#include "gastronaut/visual_pose_t.hpp"
#include "process/channels.hpp"

using namespace gastronaut;

namespace {

using Arrivals = std::map<std::int64_t, std::int64_t>;  // log time by the message's utime

template <class Message>
void note(const LogReader::Event& event, Arrivals& arrivals) {
  Message message;
  if (decode_message(event.payload, message) != DecodeResult::kOk) return;
  arrivals.emplace(message.utime, event.log_utime);
}

void print(const std::string& from, const Arrivals& raw, const std::string& to,
           const Arrivals& derived) {
  std::vector<double> latency;  // seconds
  for (const auto& [utime, arrival] : raw) {
    const auto result = derived.find(utime);
    if (result == derived.end()) continue;
    latency.push_back(static_cast<double>(result->second - arrival) * 1e-6);
  }
  if (latency.empty()) return;
  std::sort(latency.begin(), latency.end());
  const auto percentile = [&](double share) {
    return 1e3 * latency[static_cast<std::size_t>(share * static_cast<double>(latency.size() - 1))];
  };
  std::printf("%-10s to %-13s %6zu of %6zu  median %6.1f ms  90 %% %6.1f  99 %% %6.1f  max %6.1f\n",
              from.c_str(), to.c_str(), latency.size(), raw.size(), percentile(0.5),
              percentile(0.9), percentile(0.99), percentile(1));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: live_latency LOG\n");
    return 2;
  }
  std::map<std::string, Arrivals> arrivals;
  LogReader reader(argv[1]);
  while (const auto event = reader.next()) {
    Arrivals& of_channel = arrivals[event->channel];
    if (event->channel == channel::kCamera) note<image_t>(*event, of_channel);
    if (event->channel == channel::kHallArray) note<hall_array_t>(*event, of_channel);
    if (event->channel == channel::kMagneticPose) note<magnetic_pose_t>(*event, of_channel);
    if (event->channel == channel::kDepth) note<depth_image_t>(*event, of_channel);
    if (event->channel == channel::kVisualPose) note<visual_pose_t>(*event, of_channel);
    if (event->channel == channel::kCapsuleState) note<capsule_state_t>(*event, of_channel);
  }
  for (const char* to : {channel::kMagneticPose, channel::kCapsuleState}) {
    print(channel::kHallArray, arrivals[channel::kHallArray], to, arrivals[to]);
  }
  for (const char* to : {channel::kDepth, channel::kVisualPose, channel::kCapsuleState}) {
    print(channel::kCamera, arrivals[channel::kCamera], to, arrivals[to]);
  }
}
