// The parser on descriptors of real cameras, against another program's reading of them.
#include "uvc_camera/uvc_descriptors.hpp"

#include <gmock/gmock.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <regex>

#include "unit/drivers/uvc_camera/played_camera.hpp"

namespace gastronaut {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

fs::path shared_data() {
  const char* set = std::getenv("GASTRONAUT_DATA");
  return set != nullptr ? fs::path(set)
                        : fs::path(GASTRONAUT_SOURCE_DIR) / ".." / "shared" / "data";
}

Octets read_bytes(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// What usbtreeview printed of one camera.
struct Decode {
  std::vector<std::pair<int, int>> sizes;  // of all formats
  std::vector<std::uint32_t> intervals;    // of all sizes
  std::vector<std::string> formats;
  std::vector<int> isochronous;  // bytes a microframe of each setting
  int version = 0;
  double clock_frequency = 0;
};

Decode read_decode(const fs::path& path) {
  Decode decode;
  std::ifstream file(path);
  std::string line, section;
  const std::regex field(R"(^\s*([A-Za-z]+)(\[\d+\])?\s*: 0x([0-9A-Fa-f]+))");
  const std::regex guid(R"(^guidFormat\s*: .*\((\w+)\))");
  bool is_isochronous = false;
  bool is_still = false;
  int width = 0;
  while (std::getline(file, line)) {
    if (line.find("Other Speed Configuration") != std::string::npos) break;
    if (line.find("---") != std::string::npos) {
      section = line;
      is_still = section.find("Still") != std::string::npos;
      if (section.find("MJPEG Format") != std::string::npos) decode.formats.push_back("MJPEG");
    }
    std::smatch match;
    if (std::regex_search(line, match, guid)) decode.formats.push_back(match[1]);
    if (!std::regex_search(line, match, field) || is_still) continue;
    const std::string name = match[1];
    const auto value = static_cast<std::uint32_t>(std::stoul(match[3], nullptr, 16));
    if (name == "bcdUVC" && decode.version == 0) decode.version = static_cast<int>(value);
    if (name == "dwClockFreq" && decode.clock_frequency == 0) decode.clock_frequency = value;
    if (name == "wWidth") width = static_cast<int>(value);
    if (name == "wHeight") decode.sizes.emplace_back(width, static_cast<int>(value));
    if (name == "adwFrameInterval") decode.intervals.push_back(value);
    if (name == "bmAttributes" && section.find("Endpoint") != std::string::npos) {
      is_isochronous = (value & 3) == 1;
    }
    if (name == "wMaxPacketSize" && is_isochronous) {
      decode.isochronous.push_back(static_cast<int>((value & 0x7ff) * (1 + ((value >> 11) & 3))));
    }
  }
  return decode;
}

class RealCamera : public ::testing::TestWithParam<const char*> {};

TEST_P(RealCamera, IsReadAsAnotherProgramReadsIt) {
  const fs::path folder = shared_data() / "uvc_descriptors";
  if (!fs::exists(folder)) GTEST_SKIP() << "no " << folder;
  fs::path binary;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename();
    if (name.starts_with(std::string(GetParam()) + "__") && name.ends_with("_cfg_desc.bin")) {
      binary = entry.path();
    }
  }
  const std::vector<UvcFunction> functions = parse_uvc_descriptors(read_bytes(binary));
  const Decode decode = read_decode(folder / (std::string(GetParam()) + "_usbtreeview.txt"));
  ASSERT_FALSE(decode.sizes.empty());
  ASSERT_FALSE(functions.empty());
  Decode ours;
  for (const UvcFunction& function : functions) {
    for (const UvcStream& stream : function.streams) {
      for (const UvcFormat& format : stream.formats) {
        ours.formats.push_back(format.name);
        for (const UvcFrameSize& size : format.sizes) {
          ours.sizes.emplace_back(size.width, size.height);
          ours.intervals.insert(ours.intervals.end(), size.intervals.begin(), size.intervals.end());
        }
      }
      for (const UvcAlternate& alternate : stream.alternates) {
        if (alternate.isochronous) ours.isochronous.push_back(alternate.bytes);
      }
    }
  }
  EXPECT_EQ(functions.front().version, decode.version);
  EXPECT_EQ(functions.front().clock_frequency, decode.clock_frequency);
  EXPECT_EQ(ours.formats, decode.formats);
  EXPECT_EQ(ours.sizes, decode.sizes);
  EXPECT_EQ(ours.intervals, decode.intervals);
  // Microphones have isochronous endpoints, too, behind the camera's.
  ASSERT_GE(decode.isochronous.size(), ours.isochronous.size());
  EXPECT_EQ(ours.isochronous,
            std::vector(
                decode.isochronous.begin(),
                decode.isochronous.begin() + static_cast<std::ptrdiff_t>(ours.isochronous.size())));
  for (const UvcFunction& function : functions) EXPECT_NE(function.camera_terminal, 0);
}

INSTANTIATE_TEST_SUITE_P(Shared, RealCamera,
                         ::testing::Values("anker_powerconf_c200", "canyon_cne_cwc2",
                                           "customer_dual", "elp_h264", "elp_h265", "logitech_c270",
                                           "logitech_streamcam", "trust_webcam"),
                         [](const auto& instance) { return std::string(instance.param); });

TEST(UvcDescriptors, EveryRealDescriptorCutAnywhereIsReadOrRefused) {
  const fs::path folder = shared_data() / "uvc_descriptors";
  if (!fs::exists(folder)) GTEST_SKIP() << "no " << folder;
  int cut = 0;
  int refused = 0;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (entry.path().extension() != ".bin") continue;
    const Octets whole = read_bytes(entry.path());
    for (std::size_t size = 0; size < whole.size(); ++size) {
      ++cut;
      try {
        parse_uvc_descriptors(std::span(whole).first(size));
      } catch (const std::runtime_error& problem) {
        ++refused;
        EXPECT_STRNE(problem.what(), "");
      }
    }
  }
  // Only at a boundary of two descriptors is there nothing to complain of.
  EXPECT_GT(refused, cut / 2);
}

TEST(UvcDescriptors, ACameraMadeFromTheStandardIsUnderstood) {
  const auto functions = parse_uvc_descriptors(PlayedCamera(true).configuration_descriptor());
  ASSERT_EQ(functions.size(), 1u);
  const UvcFunction& function = functions.front();
  EXPECT_EQ(function.version, 0x0110);
  EXPECT_EQ(function.clock_frequency, PlayedCamera::kClockFrequency);
  EXPECT_TRUE(function.has(UvcTerminalControl::kExposureTime));
  EXPECT_FALSE(function.has(UvcTerminalControl::kFocus));
  EXPECT_TRUE(function.has(UvcProcessingControl::kGain));
  EXPECT_FALSE(function.has(UvcProcessingControl::kBrightness));
  ASSERT_EQ(function.streams.size(), 1u);
  const UvcStream& stream = function.streams.front();
  EXPECT_TRUE(stream.is_isochronous());
  EXPECT_EQ(stream.endpoint, PlayedCamera::kEndpoint);
  ASSERT_EQ(stream.formats.size(), 2u);
  EXPECT_EQ(stream.formats[0].encoding, UvcEncoding::kMjpeg);
  EXPECT_EQ(stream.formats[1].encoding, UvcEncoding::kYuyv);
  EXPECT_THAT(stream.formats[1].sizes[0].intervals, ElementsAre(333333, 500000, 1000000, 2000000));
  // The narrowest that carries a payload; three transactions of 1024 are the widest.
  EXPECT_EQ(stream.alternate_for(100).setting, 1);
  EXPECT_EQ(stream.alternate_for(1024).setting, 2);
  EXPECT_EQ(stream.alternate_for(5000).bytes, 3072);
}

TEST(UvcDescriptors, ABulkCameraHasOneSetting) {
  const auto functions = parse_uvc_descriptors(PlayedCamera(false).configuration_descriptor());
  const UvcStream& stream = functions.at(0).streams.at(0);
  EXPECT_FALSE(stream.is_isochronous());
  EXPECT_EQ(stream.alternate_for(PlayedCamera::kBulkPayload).setting, 0);
}

TEST(UvcDescriptors, TheNearestRateIsChosen) {
  UvcFrameSize size;
  size.intervals = {333333, 500000, 1000000};
  EXPECT_EQ(size.nearest_interval(0.04), 333333u);
  EXPECT_EQ(size.nearest_interval(0.09), 1000000u);
  UvcFrameSize stepped;
  stepped.shortest = 333333;
  stepped.longest = 1333332;
  stepped.step = 333333;
  EXPECT_EQ(stepped.nearest_interval(0.07), 666666u);
  EXPECT_EQ(stepped.nearest_interval(5), 1333332u);
}

TEST(UvcDescriptors, WhatIsCutShortIsNamed) {
  Octets bytes = PlayedCamera(true).configuration_descriptor();
  bytes.pop_back();
  try {
    parse_uvc_descriptors(bytes);
    FAIL();
  } catch (const std::runtime_error& problem) {
    EXPECT_THAT(problem.what(), HasSubstr("cut short"));
  }
  EXPECT_THROW(parse_uvc_descriptors(Octets{9, 4, 0}), std::runtime_error);
  EXPECT_THROW(parse_uvc_descriptors(Octets{0, 4}), std::runtime_error);
  EXPECT_TRUE(parse_uvc_descriptors(Octets{}).empty());
}

}  // namespace
}  // namespace gastronaut
