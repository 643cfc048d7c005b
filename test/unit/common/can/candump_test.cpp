#include "can/candump.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>

namespace gastronaut {
namespace {

using ::testing::HasSubstr;

std::string error_of(const std::string& line) {
  try {
    parse_candump_line(line);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "no error";
}

TEST(Candump, ClassicFramesAreRead) {
  const CandumpLine line = parse_candump_line("(1618787934.854636) can0 0C5#3000000030000001\r");
  EXPECT_EQ(line.interface, "can0");
  EXPECT_EQ(line.frame.utime, 1618787934854636);
  EXPECT_EQ(line.frame.id, 0xC5U);
  EXPECT_FALSE(line.frame.extended || line.frame.fd || line.frame.remote || line.frame.error);
  ASSERT_EQ(line.frame.length, 8);
  EXPECT_EQ(line.frame.data[0], 0x30);
  EXPECT_EQ(line.frame.data[7], 0x01);
}

TEST(Candump, EveryKindOfFrameIsReadAndWrittenBack) {
  for (const char* text :
       {"(1618787934.854636) can0 0C5#3000000030000001", "(0000000000.000001) vcan0 7FF#",
        "(1618787934.000000) can1 1FFFFFFF#AB", "(1618787934.000000) can1 123##0",
        "(1618787934.000000) can1 123##1AABBCCDDEEFF001122334455", "(1618787934.000000) can1 123#R",
        "(1618787934.000000) can1 123#R8", "(1618787934.000000) can1 20000040#0000000000000000"}) {
    EXPECT_EQ(format_candump_line(parse_candump_line(text)), text);
  }
  EXPECT_TRUE(parse_candump_line("(1.0) c 123##1AA").frame.bit_rate_switch);
  EXPECT_TRUE(parse_candump_line("(1.0) c 20000040#00").frame.error);
  EXPECT_TRUE(parse_candump_line("(1.0) c 00000040#00").frame.extended);
}

TEST(Candump, TimesInNanosecondsDirectionsAndLongLengthCodesAreUnderstood) {
  EXPECT_EQ(parse_candump_line("(1618787934.854636999) c 1A5#00").frame.utime, 1618787934854636);
  EXPECT_EQ(parse_candump_line("(1.5) c 1A5#00").frame.utime, 1500000);
  EXPECT_EQ(parse_candump_line("(1.5) c 1A5#00 R").frame.length, 1);
  EXPECT_EQ(parse_candump_line("(1.5) c 1A5#1122334455667788_9").frame.length, 8);
}

TEST(Candump, DamagedLinesAreRefusedInWords) {
  EXPECT_THAT(error_of(""), HasSubstr("begin with (time)"));
  EXPECT_THAT(error_of("1.0 can0 123#00"), HasSubstr("begin with (time)"));
  EXPECT_THAT(error_of("(x.0) can0 123#00"), HasSubstr("no time"));
  EXPECT_THAT(error_of("(99999999999999999.0) can0 123#00"), HasSubstr("no time"));
  EXPECT_THAT(error_of("(1.0) 123#00"), HasSubstr("no interface"));
  EXPECT_THAT(error_of("(1.0) can0 12#00"), HasSubstr("3 or 8 digits"));
  EXPECT_THAT(error_of("(1.0) can0 8FF#00"), HasSubstr("at most 7FF"));
  EXPECT_THAT(error_of("(1.0) can0 123 00"), HasSubstr("no #"));
  EXPECT_THAT(error_of("(1.0) can0 123#0"), HasSubstr("pairs"));
  EXPECT_THAT(error_of("(1.0) can0 123#0G"), HasSubstr("pairs"));
  EXPECT_THAT(error_of("(1.0) can0 123#000102030405060708"), HasSubstr("at most 8"));
  EXPECT_THAT(error_of("(1.0) can0 123#R9"), HasSubstr("at most 8"));
  EXPECT_THAT(error_of("(1.0) can0 123##"), HasSubstr("flags"));
  EXPECT_THAT(error_of("(1.0) can0 123##1000102030405060708"), HasSubstr("this length"));
}

// Real traffic of three cars: what is written again is what was read.
TEST(Candump, RealLogsAreReadWhole) {
  const char* data = std::getenv("GASTRONAUT_DATA");
  const std::filesystem::path folder =
      std::filesystem::path(data != nullptr ? data : GASTRONAUT_SOURCE_DIR "/../shared/data") /
      "can_logs";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no " << folder;
  std::int64_t frames = 0;
  for (const auto& file : std::filesystem::recursive_directory_iterator(folder)) {
    if (file.path().extension() != ".log") continue;
    std::ifstream log(file.path());
    for (std::string line; std::getline(log, line); ++frames) {
      if (!line.empty() && line.back() == '\r') line.pop_back();
      ASSERT_EQ(format_candump_line(parse_candump_line(line)), line) << file.path();
    }
  }
  constexpr std::int64_t kMostOfThem = 70'000;  // the folder's README counts 65 677 in one of them
  EXPECT_GT(frames, kMostOfThem);
}

}  // namespace
}  // namespace gastronaut
