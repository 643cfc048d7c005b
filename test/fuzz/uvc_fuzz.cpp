// Any bytes as a camera's configuration descriptor, and as the payloads that it sends: cameras that
// hold what they say, frames no larger than announced, all of them from the bytes that came; or an
// error in words.
#include <algorithm>
#include <cstdint>
#include <span>
#include <stdexcept>

#include "fuzz_check.hpp"
#include "uvc_camera/uvc_descriptors.hpp"
#include "uvc_camera/uvc_frame_assembler.hpp"

using namespace gastronaut;

namespace {

void check_descriptors(std::span<const std::uint8_t> bytes) {
  try {
    for (const UvcFunction& function : parse_uvc_descriptors(bytes)) {
      for (const UvcStream& stream : function.streams) {
        for (const UvcFormat& format : stream.formats) {
          for (const UvcFrameSize& size : format.sizes) {
            constexpr double kPeriod = 0.05;
            const std::uint32_t interval = size.nearest_interval(kPeriod);
            promise(size.intervals.empty() ||
                        std::count(size.intervals.begin(), size.intervals.end(), interval) > 0,
                    "an interval is one of those offered");
          }
        }
        if (stream.alternates.empty()) continue;
        try {
          constexpr std::uint32_t kBytes = 1024;
          promise(stream.alternate_for(kBytes).bytes > 0, "a setting that is chosen carries data");
        } catch (const std::runtime_error&) {  // none of them carries anything
        }
      }
    }
  } catch (const std::runtime_error& problem) {
    promise(problem.what()[0] != '\0', "an error has words");
  }
}

// Each payload begins with a byte that is its length.
void check_payloads(std::span<const std::uint8_t> bytes, bool is_bulk) {
  constexpr std::size_t kLargest = 300;
  constexpr std::size_t kPayload = 64;
  std::size_t given = 0;
  std::size_t taken = 0;
  UvcFrameAssembler assembler({kLargest, kPayload, 1e6}, [&](UvcFrame frame) {
    promise(!frame.data.empty() && frame.data.size() <= kLargest, "frames are as announced");
    promise(!frame.capture || *frame.capture <= frame.arrival + 1'000'000,
            "no picture is from the future");
    taken += frame.data.size();
  });
  std::int64_t utime = 1'700'000'000'000'000;
  while (!bytes.empty()) {
    const std::size_t size = std::min<std::size_t>(bytes[0], bytes.size() - 1);
    const auto payload = bytes.subspan(1, size);
    utime += 125;
    given += size;
    if (size == 0) {
      assembler.add_loss();
    } else if (is_bulk) {
      assembler.add_bulk_transfer(payload, size < kPayload / 2, utime);
    } else {
      assembler.add_payload(payload, utime);
    }
    bytes = bytes.subspan(1 + size);
  }
  promise(taken <= given, "frames are made of what came");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::span bytes(data + 1, size - 1);
  if (data[0] % 3 == 0) {
    check_descriptors(bytes);
  } else {
    check_payloads(bytes, data[0] % 3 == 1);
  }
  return 0;
}
