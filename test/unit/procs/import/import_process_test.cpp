#include "import/import_process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zstd.h>

#include <algorithm>
#include <cstring>

#include "import/capture_folder.hpp"
#include "import/files.hpp"
#include "process/version.hpp"
#include "synthetic_capture.hpp"

namespace gastronaut {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr double kEpoch = 1'700'000'000;
constexpr std::int64_t kEpochUtime = 1'700'000'000'000'000;

ImportCounts import_capture(const ScratchFolder& folder, const std::string& log,
                            CollectedIssues& collected,
                            const std::vector<std::string>& settings = {}) {
  return write_recording(
      open_capture_folder(folder.path(), {{}, settings}, kEpoch, collected.issues), log,
      collected.issues);
}

std::vector<std::uint16_t> counts_of(const depth_image_t& depth) {
  std::vector<std::uint16_t> counts(static_cast<std::size_t>(depth.width * depth.height));
  const std::size_t size =
      ZSTD_decompress(counts.data(), counts.size() * 2, depth.data.data(), depth.data.size());
  EXPECT_EQ(size, counts.size() * 2);
  return counts;
}

TEST(ImportProcess, EveryMessageSaysWhatTheFolderSays) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  CollectedIssues collected;
  const std::string log = folder / "raw.lcmlog";
  import_capture(folder, log, collected);
  const auto events = read_log(log);
  EXPECT_TRUE(std::ranges::is_sorted(events, {}, &LoggedEvent::utime));
  EXPECT_EQ(events.front().channel, "RIG_CONFIG");
  EXPECT_TRUE(collected.list.empty());

  const auto configurations = read_channel<rig_config_t>(events, "RIG_CONFIG");
  ASSERT_EQ(configurations.size(), 1U);
  EXPECT_EQ(configurations[0].code_version, code_version());
  const RigConfiguration rig = parse_rig_configuration(configurations[0].yaml, "RIG_CONFIG");
  EXPECT_EQ(rig.camera.fx, 25);
  EXPECT_EQ(rig.coils.tesla_per_ampere.rows(), static_cast<int>(SyntheticCapture::kChannels));

  const auto pictures = read_channel<image_t>(events, "CAMERA");
  const auto depths = read_channel<depth_image_t>(events, "GROUND_TRUTH_DEPTH");
  const auto poses = read_channel<rigid_transform_t>(events, "GROUND_TRUTH_POSE");
  ASSERT_EQ(pictures.size(), static_cast<std::size_t>(SyntheticCapture::kFrames));
  ASSERT_EQ(depths.size(), pictures.size());
  ASSERT_EQ(poses.size(), pictures.size());
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    EXPECT_EQ(pictures[i].utime, kEpochUtime + static_cast<std::int64_t>(i) * 50'000);
    EXPECT_EQ(pictures[i].pixelformat, image_t::PIXEL_FORMAT_MJPEG);
    EXPECT_EQ(pictures[i].data, capture.pictures[i]);
    ASSERT_EQ(pictures[i].nmetadata, 1);
    EXPECT_EQ(pictures[i].metadata[0].key, "seq");
    EXPECT_THAT(pictures[i].metadata[0].value, ElementsAre('0' + i));
    EXPECT_EQ(depths[i].utime, pictures[i].utime);
    // A wall across the axis has the same depth everywhere, whatever the lens.
    EXPECT_EQ(std::ranges::count(counts_of(depths[i]), 4000),
              SyntheticCapture::kWidth * SyntheticCapture::kHeight);
    EXPECT_EQ(depths[i].metres_per_count, SyntheticCapture::kMetresPerCount);
    EXPECT_EQ(depths[i].fx, 25);
    EXPECT_THAT(poses[i].trans, ElementsAre(capture.camera[i].x(), 0.002, 0.003));
    EXPECT_THAT(poses[i].quat, ElementsAre(0, 1, 0, 0));
  }

  const auto hall = read_channel<hall_array_t>(events, "HALL_ARRAY");
  const auto currents = read_channel<coil_currents_t>(events, "COIL_CURRENTS");
  ASSERT_EQ(hall.size(), static_cast<std::size_t>(SyntheticCapture::kReadings));
  ASSERT_EQ(currents.size(), hall.size());
  constexpr double kFloat = 1e-7;  // relative
  for (std::size_t i = 0; i < hall.size(); ++i) {
    EXPECT_EQ(hall[i].utime, kEpochUtime + static_cast<std::int64_t>(i) * 10'000);
    EXPECT_EQ(hall[i].seq, static_cast<std::int32_t>(i));
    for (int s = 0; s < 4; ++s) {
      for (int a = 0; a < 3; ++a) {
        EXPECT_NEAR(hall[i].field[static_cast<std::size_t>(s)][static_cast<std::size_t>(a)],
                    capture.hall[i][3 * s + a], kFloat * capture.hall[i].norm());
      }
    }
    EXPECT_THAT(hall[i].status, ElementsAre(0, 0, 0, 0));
    EXPECT_NEAR(currents[i].current[0], capture.currents[i][0], kFloat * 2);
  }
}

TEST(ImportProcess, SameFolderGivesSameBytes) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  CollectedIssues collected;
  import_capture(folder, folder / "first.lcmlog", collected);
  import_capture(folder, folder / "second.lcmlog", collected);
  EXPECT_EQ(read_file(folder / "first.lcmlog"), read_file(folder / "second.lcmlog"));
}

TEST(ImportProcess, BadRowsAndDamagedPicturesAreLeftOutAndLeaveGaps) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  std::string hall = read_text(folder / "hall.csv");
  hall.insert(hall.find('\n') + 1, "garbage\n");
  folder.write("hall.csv", hall);
  const auto& picture = capture.pictures[2];
  folder.write(
      "rgb/000002.jpg",
      {picture.begin(), picture.begin() + static_cast<std::ptrdiff_t>(picture.size() / 2)});
  folder.write("depth/000003.png", "");
  CollectedIssues collected;
  const std::string log = folder / "raw.lcmlog";
  const ImportCounts counts = import_capture(folder, log, collected);
  EXPECT_EQ(counts.at("CAMERA"), SyntheticCapture::kFrames - 1U);
  EXPECT_EQ(counts.at("GROUND_TRUTH_DEPTH"), SyntheticCapture::kFrames - 1U);
  EXPECT_EQ(counts.at("HALL_ARRAY"), static_cast<std::size_t>(SyntheticCapture::kReadings));
  EXPECT_THAT(collected.list, ElementsAre(HasSubstr("hall.csv:2: 1 numbers instead of 13"),
                                          HasSubstr("000002.jpg: is a damaged JPEG"),
                                          HasSubstr("000003.png: is empty")));
  const auto events = read_log(log);
  EXPECT_THAT(read_channel<image_t>(events, "CAMERA")[2].metadata[0].value, ElementsAre('3'));
  EXPECT_EQ(read_channel<hall_array_t>(events, "HALL_ARRAY")[1].seq, 2);
}

TEST(ImportProcess, SaturatedSensorsAreMarked) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  CollectedIssues collected;
  const std::string log = folder / "raw.lcmlog";
  import_capture(folder, log, collected, {"hall_array.saturation=1 nT"});
  const auto hall = read_channel<hall_array_t>(read_log(log), "HALL_ARRAY");
  const std::int32_t saturated = hall_array_t::STATUS_SATURATED;
  EXPECT_THAT(hall[0].status, ElementsAre(saturated, saturated, saturated, saturated));
}

TEST(ImportProcess, ConfigurationIsRepeatedEveryTenSeconds) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  std::string late = "25.5";
  for (std::size_t i = 0; i < SyntheticCapture::kChannels; ++i) late += ",0";
  folder.write("hall.csv", read_text(folder / "hall.csv") + late + "\n");
  CollectedIssues collected;
  const std::string log = folder / "raw.lcmlog";
  import_capture(folder, log, collected);
  std::vector<std::int64_t> utimes;
  for (const auto& message : read_channel<rig_config_t>(read_log(log), "RIG_CONFIG")) {
    utimes.push_back(message.utime - kEpochUtime);
  }
  EXPECT_THAT(utimes, ElementsAre(0, 10'000'000, 20'000'000));
}

TEST(ImportProcess, WithoutAUsablePictureThereIsNoLog) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  for (int i = 0; i < SyntheticCapture::kFrames; ++i) {
    folder.write("rgb/00000" + std::to_string(i) + ".jpg", "broken");
  }
  CollectedIssues collected;
  EXPECT_THROW(import_capture(folder, folder / "raw.lcmlog", collected), std::runtime_error);
  EXPECT_FALSE(std::filesystem::exists(folder / "raw.lcmlog"));
}

}  // namespace
}  // namespace gastronaut
