#include "can/hall_array_layout.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "configuration/fields.hpp"

namespace gastronaut {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr double kFieldCount = 2e-7;    // tesla a count, in both of the project's databases
constexpr double kCurrentCount = 1e-5;  // ampere

HallArrayLayout project_layout(const std::string& name) {
  RigConfiguration rig;
  rig.can_hall_array.dbc = name;
  return load_hall_array_layout(rig, {GASTRONAUT_SOURCE_DIR "/config/any.yaml"});
}

// Two sensors of one axis each and a coil, in its own words.
constexpr const char* kOtherArray =
    "BO_ 10 A: 4 X\n"
    " SG_ n : 0|4@1+ (1,0) [0|0] \"\" X\n"
    " SG_ B1z : 8|16@1- (0.5,0) [0|0] \"uT\" X\n"
    "BO_ 11 B: 4 X\n"
    " SG_ n : 0|4@1+ (1,0) [0|0] \"\" X\n"
    " SG_ B2z : 15|16@0- (0.5,0) [0|0] \"uT\" X\n"
    "BO_ 12 C: 4 X\n"
    " SG_ n : 0|4@1+ (1,0) [0|0] \"\" X\n"
    " SG_ I1 : 8|16@1- (1,0) [0|0] \"mA\" X\n";

CanHallArrayConfiguration other_names() {
  CanHallArrayConfiguration names;
  names.field_signal = "B{sensor}{axis}";
  names.current_signal = "I{coil}";
  names.counter_signal = "n";
  names.first_number = 1;
  return names;
}

HallArrayLayout other_array(const std::string& dbc = kOtherArray, int sensors = 2, int axes = 1) {
  return {parse_dbc(dbc, "other.dbc"), "other.dbc", other_names(), sensors, axes};
}

std::string error_of(std::string dbc, const std::string& replaced, const std::string& by,
                     int sensors = 2, int axes = 1) {
  const std::size_t at = dbc.find(replaced);
  EXPECT_NE(at, std::string::npos);
  if (at != std::string::npos) dbc.replace(at, replaced.size(), by);
  try {
    other_array(dbc, sensors, axes);
  } catch (const ConfigurationError& error) {
    return error.what();
  }
  return "no error";
}

class ProjectDatabases : public ::testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(HallArrayLayout, ProjectDatabases,
                         ::testing::Values("hall_array.dbc", "hall_array_classic.dbc"));

TEST_P(ProjectDatabases, ReadingsOfCountsComeBackBitByBit) {
  const HallArrayLayout layout = project_layout(GetParam());
  EXPECT_EQ(layout.num_coils(), 9);
  ASSERT_TRUE(layout.has_status());
  std::mt19937 random(1);
  std::uniform_int_distribution<int> field(-65536, 65535);  // 13 mT: more than the sensors'
  std::uniform_int_distribution<int> current(-8388608, 8388607);
  for (const CanStream stream : {CanStream::kField, CanStream::kCurrents}) {
    const bool is_field = stream == CanStream::kField;
    std::vector<double> sent(layout.num_values(stream));
    for (std::size_t i = 0; i < sent.size(); ++i) {
      sent[i] = !is_field ? current(random) * kCurrentCount
                : i < layout.status_place(0)
                    ? static_cast<double>(static_cast<float>(field(random) * kFieldCount))
                    : static_cast<double>(i % 8);
    }
    constexpr std::uint64_t kCounter = 77;
    std::vector<double> received(sent.size(), kNotArrived);
    std::vector<bool> parts(static_cast<std::size_t>(layout.num_parts(stream)), false);
    HallArrayLayout::Contribution contribution;
    for (const CanFrame& frame : layout.encode(stream, kCounter, sent)) {
      ASSERT_EQ(layout.decode(frame, contribution), HallArrayLayout::Outcome::kDecoded);
      EXPECT_EQ(contribution.stream, stream);
      EXPECT_EQ(contribution.counter, kCounter);
      parts[static_cast<std::size_t>(contribution.part)] = true;
      for (const auto& [place, value] : contribution.values) received[place] = value;
    }
    EXPECT_THAT(parts, ::testing::Each(true));
    for (std::size_t i = 0; i < sent.size(); ++i) {
      EXPECT_EQ(static_cast<float>(received[i]), static_cast<float>(sent[i])) << i;
    }
  }
}

TEST(HallArrayLayout, FramesFitTheirBus) {
  const auto check = [](const char* name, bool fd, std::size_t frames_a_reading) {
    const HallArrayLayout layout = project_layout(name);
    const std::vector<double> zeros(layout.num_values(CanStream::kField));
    const std::vector<CanFrame> frames = layout.encode(CanStream::kField, 0, zeros);
    EXPECT_EQ(frames.size(), frames_a_reading);
    for (const CanFrame& frame : frames) {
      EXPECT_EQ(frame.fd, fd);
      EXPECT_EQ(frame.length, fd ? 64 : 8);
    }
  };
  check("hall_array.dbc", true, 8);
  check("hall_array_classic.dbc", false, 64);
}

TEST(HallArrayLayout, AnotherArrayIsOnlyConfiguration) {
  const HallArrayLayout layout = other_array();
  EXPECT_EQ(layout.num_coils(), 1);
  EXPECT_FALSE(layout.has_status());
  EXPECT_EQ(layout.num_parts(CanStream::kField), 2);
  EXPECT_EQ(layout.counter_bits(CanStream::kField), 4);
  CanFrame frame;
  frame.id = 11;
  frame.length = 4;
  frame.data = {0x25, 0xFF, 0xFE, 0};  // counter 5; big endian -2 counts of 0.5 uT
  HallArrayLayout::Contribution contribution;
  ASSERT_EQ(layout.decode(frame, contribution), HallArrayLayout::Outcome::kDecoded);
  EXPECT_EQ(contribution.counter, 5U);
  ASSERT_EQ(contribution.values.size(), 1U);
  EXPECT_EQ(contribution.values[0].first, 1U);
  EXPECT_DOUBLE_EQ(contribution.values[0].second, -1e-6);
  frame.id = 12;
  frame.data = {0x05, 0x10, 0x27, 0};  // 10 000 mA
  ASSERT_EQ(layout.decode(frame, contribution), HallArrayLayout::Outcome::kDecoded);
  EXPECT_EQ(contribution.stream, CanStream::kCurrents);
  EXPECT_DOUBLE_EQ(contribution.values[0].second, 10);
}

TEST(HallArrayLayout, ForeignAndMalformedFramesAreToldApart) {
  const HallArrayLayout layout = other_array();
  HallArrayLayout::Contribution contribution;
  CanFrame frame;
  frame.id = 11;
  frame.length = 3;
  EXPECT_EQ(layout.decode(frame, contribution), HallArrayLayout::Outcome::kMalformed);
  frame.length = 4;
  frame.remote = true;
  EXPECT_EQ(layout.decode(frame, contribution), HallArrayLayout::Outcome::kMalformed);
  frame.remote = false;
  frame.extended = true;
  EXPECT_EQ(layout.decode(frame, contribution), HallArrayLayout::Outcome::kForeign);
  frame.extended = false;
  frame.error = true;
  EXPECT_EQ(layout.decode(frame, contribution), HallArrayLayout::Outcome::kForeign);
  // A case of the multiplexor that no signal has.
  const HallArrayLayout classic = project_layout("hall_array_classic.dbc");
  CanFrame coils = classic.encode(CanStream::kCurrents, 1, std::vector<double>(9, 1.0)).front();
  coils.data[1] = 5;
  EXPECT_EQ(classic.decode(coils, contribution), HallArrayLayout::Outcome::kForeign);
}

TEST(HallArrayLayout, ADatabaseThatDoesNotFitIsRefusedByName) {
  const std::string good = kOtherArray;
  EXPECT_EQ(error_of(good, "n", "n"), "no error");
  EXPECT_THAT(error_of(good, "n", "n", 3),
              AllOf(HasSubstr("other.dbc"), HasSubstr("no signal B3z")));
  EXPECT_THAT(error_of(good, "n", "n", 2, 3), HasSubstr("no signal B1x"));
  EXPECT_THAT(error_of(good, "\"uT\"", "\"V\""),
              AllOf(HasSubstr("other.dbc:3: "), HasSubstr("unit 'V'")));
  EXPECT_THAT(error_of(good, "SG_ n", "SG_ m"),
              AllOf(HasSubstr("other.dbc:1: "), HasSubstr("no cycle counter")));
  EXPECT_THAT(error_of(good, "0|4@1+", "0|5@1+"), HasSubstr("as many in every message"));
  EXPECT_THAT(error_of(good, "0|4@1+", "0|4@1-"), HasSubstr("unsigned"));
  EXPECT_THAT(error_of(good, "8|16@1- (0.5", "3|16@1- (0.5"), HasSubstr("share bit 3"));
  EXPECT_THAT(error_of(good, "B2z", "B1z"), HasSubstr("more than one message has a signal B1z"));
  EXPECT_THAT(error_of(good, " SG_ B1z", " SG_ I2 : 24|8@1- (1,0) [0|0] \"A\" X\n SG_ B1z"),
              HasSubstr("fields and currents"));
  EXPECT_THAT(error_of(good, " SG_ B1z :",
                       " SG_ w M : 4|4@1+ (1,0) [0|0] \"\" X\n"
                       " SG_ B3z m1 : 8|8@1- (1,0) [0|0] \"T\" X\n SG_ B1z :",
                       3),
              HasSubstr("multiplexed"));
}

}  // namespace
}  // namespace gastronaut
