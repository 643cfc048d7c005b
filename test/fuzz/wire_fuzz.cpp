// Bytes from the network: decoded or refused, never believed. The first byte chooses the type; its
// top bit, whether the type's fingerprint is put in front of the rest.
#include "bus/wire.hpp"
#include "fuzz_check.hpp"
#include "message_types.hpp"

using namespace gastronaut;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  constexpr std::uint8_t kRaw = 0x80;
  visit_message_type((data[0] & ~kRaw) % kMessageTypes, [&](auto message) {
    std::vector<std::uint8_t> payload;
    if ((data[0] & kRaw) == 0) {
      const auto fingerprint = static_cast<std::uint64_t>(decltype(message)::getHash());
      for (int shift = 56; shift >= 0; shift -= 8) {
        payload.push_back(static_cast<std::uint8_t>(fingerprint >> shift));
      }
    }
    payload.insert(payload.end(), data + 1, data + size);
    if (decode_message(payload, message) != DecodeResult::kOk) return;
    promise(encode_message(message) == payload, "what was decoded encodes to the same bytes");
  });
  return 0;
}
