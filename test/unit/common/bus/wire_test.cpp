#include "bus/wire.hpp"

#include <gtest/gtest.h>

namespace gastronaut {
namespace {

hall_array_t reading() {
  hall_array_t message;
  message.utime = 1234;
  message.seq = 7;
  message.num_sensors = 4;
  message.num_axes = 3;
  message.field.assign(4, {1.0F, 2.0F, 3.0F});
  message.status.assign(4, 0);
  return message;
}

capsule_state_t state() {
  capsule_state_t message{};
  message.utime = 99;
  message.num_sensors = 2;
  message.sensors.resize(2);
  message.sensors[0].name = "magnetic";
  message.sensors[1].name = "visual";
  message.sensors[1].cause = "blur";
  return message;
}

TEST(Wire, MessageComesBackAsItWas) {
  hall_array_t decoded;
  ASSERT_EQ(decode_message(encode_message(reading()), decoded), DecodeResult::kOk);
  EXPECT_EQ(decoded.seq, 7);
  EXPECT_EQ(decoded.field, reading().field);
  capsule_state_t nested;
  ASSERT_EQ(decode_message(encode_message(state()), nested), DecodeResult::kOk);
  EXPECT_EQ(nested.sensors[1].cause, "blur");
}

TEST(Wire, OtherTypeIsForeign) {
  coil_currents_t other;
  EXPECT_EQ(decode_message(encode_message(reading()), other), DecodeResult::kForeign);
}

TEST(Wire, EveryTruncationIsCorrupt) {
  for (const auto& whole : {encode_message(reading()), encode_message(state())}) {
    for (std::size_t size = 0; size < whole.size(); ++size) {
      const Bytes cut(whole.data(), size);
      hall_array_t hall;
      capsule_state_t capsule;
      EXPECT_NE(decode_message(cut, hall), DecodeResult::kOk);
      EXPECT_NE(decode_message(cut, capsule), DecodeResult::kOk);
    }
  }
}

TEST(Wire, TrailingBytesAreCorrupt) {
  auto payload = encode_message(reading());
  payload.push_back(0);
  hall_array_t decoded;
  EXPECT_EQ(decode_message(payload, decoded), DecodeResult::kCorrupt);
}

TEST(Wire, HugeAndNegativeCountsAreRefusedBeforeAnythingIsAllocated) {
  constexpr std::size_t kNumSensorsAt = 8 + 8 + 4;  // fingerprint, utime, seq
  for (const std::uint8_t top : {std::uint8_t{0x7f}, std::uint8_t{0xff}}) {
    auto payload = encode_message(reading());
    payload[kNumSensorsAt] = top;
    hall_array_t decoded;
    EXPECT_EQ(decode_message(payload, decoded), DecodeResult::kCorrupt);
  }
}

TEST(Wire, ManyRowsOfNoColumnsAreRefused) {
  auto payload = encode_message(reading());
  constexpr std::size_t kNumSensorsAt = 8 + 8 + 4;
  constexpr std::size_t kNumAxesAt = kNumSensorsAt + 4;
  payload[kNumSensorsAt] = 0x10;
  for (std::size_t i = 0; i < 4; ++i) payload[kNumAxesAt + i] = 0;
  hall_array_t decoded;
  EXPECT_EQ(decode_message(payload, decoded), DecodeResult::kCorrupt);
}

TEST(Wire, FingerprintFindsItsType) {
  const WireLayout* layout =
      layout_of_fingerprint(static_cast<std::uint64_t>(hall_array_t::getHash()));
  ASSERT_NE(layout, nullptr);
  EXPECT_STREQ(layout->name, "gastronaut.hall_array_t");
  EXPECT_EQ(layout_of_fingerprint(0), nullptr);
}

}  // namespace
}  // namespace gastronaut
