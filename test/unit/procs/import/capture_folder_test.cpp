#include "import/capture_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "synthetic_capture.hpp"

namespace gastronaut {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr double kEpoch = 1000;

std::string failure_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const std::exception& problem) {
    return problem.what();
  }
  return "nothing was thrown";
}

void open(const ScratchFolder& folder, CollectedIssues& collected) {
  open_capture_folder(folder.path(), {}, kEpoch, collected.issues);
}

TEST(CaptureFolder, CalibrationBecomesARigConfiguration) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  const RigConfiguration rig = read_capture_calibration(folder / "calib.yaml");
  EXPECT_EQ(rig.camera.width, SyntheticCapture::kWidth);
  EXPECT_THAT(rig.camera.distortion, ElementsAre(-0.12, 0.018, 0, 0));
  EXPECT_EQ(rig.camera.metres_per_depth_count, SyntheticCapture::kMetresPerCount);
  EXPECT_EQ(rig.lights.lobe, 1.2);
  EXPECT_THAT(rig.camera_T_magnet.rotation, ElementsAre(0, 1, 0, 0));  // w x y z
  EXPECT_EQ(rig.hall_array.num_sensors(), 4);
  // The coil matrix and the readings tell the magnet's field apart from the coils'.
  const Eigen::VectorXd& reading = capture.hall[3];
  const Eigen::VectorXd magnet = reading - rig.coils.tesla_per_ampere * capture.currents[3];
  EXPECT_GT(magnet.norm(), 0);
  EXPECT_EQ(rig.coils.tesla_per_ampere.rows(), static_cast<int>(SyntheticCapture::kChannels));
  EXPECT_EQ(rig.coils.tesla_per_ampere.cols(), static_cast<int>(SyntheticCapture::kCoils));
}

TEST(CaptureFolder, OverridesWin) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  CollectedIssues collected;
  const std::string rig = folder.write("rig.yaml", "name: bench\nhall_array: {noise: 3 uT}\n");
  const Recording recording =
      open_capture_folder(folder.path(), {{rig}, {"camera.gamma=1"}}, kEpoch, collected.issues);
  EXPECT_EQ(recording.rig.name, "bench");
  EXPECT_EQ(recording.rig.hall_array.noise, 3e-6);
  EXPECT_EQ(recording.rig.camera.gamma, 1);
}

TEST(CaptureFolder, MissingFilesAreNamedWithWhatIsExpected) {
  for (const char* name : {"calib.yaml", "hall.csv", "coils.csv", "rgb"}) {
    const ScratchFolder folder;
    const SyntheticCapture capture(folder);
    CollectedIssues collected;
    std::filesystem::remove_all(folder / name);
    EXPECT_THAT(failure_of([&] { open(folder, collected); }),
                HasSubstr(std::string(name) + " is missing; expected a capture folder"));
  }
}

TEST(CaptureFolder, TruthIsOptional) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  CollectedIssues collected;
  std::filesystem::remove_all(folder / "depth");
  std::filesystem::remove(folder / "groundtruth.txt");
  Recording recording = open_capture_folder(folder.path(), {}, kEpoch, collected.issues);
  EXPECT_TRUE(recording.poses.empty());
  const auto frame = recording.frames->next(collected.issues);
  ASSERT_TRUE(frame);
  EXPECT_TRUE(frame->depth.empty());
  EXPECT_EQ(frame->jpeg, capture.pictures[0]);
}

TEST(CaptureFolder, CalibrationMistakesAreNamed) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  CollectedIssues collected;
  const auto with = [&](const std::string& text) {
    folder.write("calib.yaml", text);
    return failure_of([&] { open(folder, collected); });
  };
  EXPECT_THAT(with("camera: {width: 48}\n"), HasSubstr("calib.yaml: camera.height is missing"));
  EXPECT_THAT(with("camera: {width: 48, height: 32, fx: 25, fy: 25, cx: 23.5, cy: 15.5, rate: 20}\n"
                   "hall: {rows: 2, cols: 2, pitch: 0.022, z: 0.085, rate: 100}\n"
                   "magnet: {moment: 0.408}\n"),
              HasSubstr("depth.metres_per_count is missing"));
  EXPECT_THAT(with("- a list"), HasSubstr("camera.width is missing"));
  EXPECT_THAT(with("{"), HasSubstr("not YAML"));
}

TEST(CaptureFolder, ATableWithoutAGoodRowIsRefused) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  CollectedIssues collected;
  folder.write("hall.csv", "0,1,2\n0.01,1,2\n");
  EXPECT_THAT(
      failure_of([&] { open(folder, collected); }),
      HasSubstr("hall.csv: has no usable row; expected the time in seconds and 12 numbers"));
  EXPECT_EQ(collected.list.size(), 2U);
}

}  // namespace
}  // namespace gastronaut
