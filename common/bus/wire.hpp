// Decoding of untrusted bytes. A message is measured against its type's layout before anything is
// allocated for it, so corrupt counts cannot ask for memory that the message does not have.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "bus/wire_layout.hpp"
#include "gastronaut/wire_schema.hpp"

namespace gastronaut {

using Bytes = std::span<const std::uint8_t>;

enum class DecodeResult {
  kOk,
  kForeign,  // the fingerprint is another type's
  kCorrupt,  // truncated, too long, or inconsistent in itself
};

// Whether `payload` (fingerprint included) has exactly the length that its own counts call for.
bool wire_length_matches(const WireLayout& layout, Bytes payload);

template <class Message>
DecodeResult decode_message(Bytes payload, Message& message) {
  constexpr std::size_t kFingerprint = 8;
  if (payload.size() < kFingerprint) return DecodeResult::kCorrupt;
  std::uint64_t fingerprint = 0;
  for (std::size_t i = 0; i < kFingerprint; ++i) fingerprint = (fingerprint << 8) | payload[i];
  if (fingerprint != static_cast<std::uint64_t>(Message::getHash())) return DecodeResult::kForeign;
  if (!wire_length_matches(WireLayoutOf<Message>::value, payload)) return DecodeResult::kCorrupt;
  const int size = static_cast<int>(payload.size());
  return message.decode(payload.data(), 0, size) == size ? DecodeResult::kOk
                                                         : DecodeResult::kCorrupt;
}

template <class Message>
std::vector<std::uint8_t> encode_message(const Message& message) {
  std::vector<std::uint8_t> payload(static_cast<std::size_t>(message.getEncodedSize()));
  message.encode(payload.data(), 0, static_cast<int>(payload.size()));
  return payload;
}

// The type with this fingerprint, nullptr: none of ours. For tools that read any channel.
const WireLayout* layout_of_fingerprint(std::uint64_t fingerprint);

}  // namespace gastronaut
