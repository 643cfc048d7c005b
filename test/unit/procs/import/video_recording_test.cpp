#include "import/video_recording.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

#include "import_fixtures.hpp"

namespace gastronaut {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr int kWidth = 64;
constexpr int kHeight = 48;
constexpr int kFrames = 5;
constexpr double kEpoch = 0;

RigConfiguration small_rig() {
  RigConfiguration rig;
  rig.camera.width = kWidth;
  rig.camera.height = kHeight;
  rig.camera.cx = 31.5;
  rig.camera.cy = 23.5;
  rig.camera.rate = 10;
  rig.hall_array.rows = 1;
  rig.hall_array.cols = 2;
  return rig;
}

cv::Mat grey(int level) { return {kHeight, kWidth, CV_8UC3, cv::Scalar::all(level)}; }

std::vector<Frame> all_frames(Recording& recording, Issues& issues) {
  std::vector<Frame> frames;
  while (auto frame = recording.frames->next(issues)) frames.push_back(std::move(*frame));
  return frames;
}

TEST(VideoRecording, FramesOfAVideoComeAtItsRateAndLookAlike) {
  const ScratchFolder folder;
  const std::string path = folder / "video.avi";
  constexpr double kVideoRate = 25;
  cv::VideoWriter writer(path, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), kVideoRate,
                         {kWidth, kHeight});
  ASSERT_TRUE(writer.isOpened());
  for (int i = 0; i < kFrames; ++i) writer.write(grey(40 * i));
  writer.release();
  CollectedIssues collected;
  VideoFiles files;
  files.pictures = path;
  Recording recording = open_video_recording(files, small_rig(), kEpoch, collected.issues);
  EXPECT_EQ(recording.rig.camera.rate, kVideoRate);
  const std::vector<Frame> frames = all_frames(recording, collected.issues);
  ASSERT_EQ(frames.size(), static_cast<std::size_t>(kFrames));
  for (int i = 0; i < kFrames; ++i) {
    const Frame& frame = frames[static_cast<std::size_t>(i)];
    EXPECT_EQ(frame.utime, i * 40'000);
    const cv::Mat decoded = cv::imdecode(frame.jpeg, cv::IMREAD_COLOR);
    constexpr double kTwiceQuantised = 4;  // grey levels
    EXPECT_LE(cv::norm(decoded, grey(40 * i), cv::NORM_INF), kTwiceQuantised);
  }
}

TEST(VideoRecording, PicturesOfAFolderStartAtZeroAndLeaveAGapForAMissingNumber) {
  const ScratchFolder folder;
  std::filesystem::create_directory(folder / "image");
  std::filesystem::create_directory(folder / "depth");
  for (const int number : {7, 8, 10}) {
    cv::imwrite(folder / ("image/frame_" + std::to_string(number) + ".jpg"), grey(100));
  }
  folder.write("image/readme_1.txt", "no picture");
  cv::imwrite(folder / "depth/8.png", cv::Mat(kHeight, kWidth, CV_16UC1, cv::Scalar(1234)));
  VideoFiles files;
  files.pictures = folder / "image";
  files.depth = folder / "depth";
  files.poses = folder.write("poses.log",
                             "0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
                             "1 1 2\n1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
  CollectedIssues collected;
  Recording recording = open_video_recording(files, small_rig(), kEpoch, collected.issues);
  const std::vector<Frame> frames = all_frames(recording, collected.issues);
  ASSERT_EQ(frames.size(), 3U);
  EXPECT_EQ(frames[0].utime, 0);
  EXPECT_EQ(frames[1].utime, 100'000);
  EXPECT_EQ(frames[1].depth[0], 1234);
  EXPECT_EQ(frames[2].utime, 300'000);
  EXPECT_EQ(frames[2].seq, 10);
  ASSERT_EQ(recording.poses.size(), 2U);
  EXPECT_EQ(recording.poses[1].utime, 100'000);
  EXPECT_EQ(recording.poses[1].rig_T_camera.translation.x(), 5);
  EXPECT_TRUE(collected.list.empty());
}

TEST(VideoRecording, TablesBesideThePicturesAreRead) {
  const ScratchFolder folder;
  std::filesystem::create_directory(folder / "image");
  cv::imwrite(folder / "image/0.jpg", grey(100));
  VideoFiles files;
  files.pictures = folder / "image";
  files.hall = folder.write("hall.csv", "t,1x,1y,1z,2x,2y,2z\n0,1,2,3,4,5,6\n0.01,1,2\n");
  files.coils = folder.write("coils.csv", "0,1,2,3\n");
  CollectedIssues collected;
  const Recording recording = open_video_recording(files, small_rig(), kEpoch, collected.issues);
  EXPECT_THAT(recording.hall.values, ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_THAT(recording.coil_currents.values, ElementsAre(1, 2, 3));
  EXPECT_THAT(collected.list, ElementsAre(HasSubstr("hall.csv:3: 3 numbers instead of 7")));
}

TEST(VideoRecording, WhatIsNoVideoIsRefused) {
  const ScratchFolder folder;
  CollectedIssues collected;
  VideoFiles files;
  files.pictures = folder.write("video.mp4", "not a video");
  EXPECT_THROW(open_video_recording(files, small_rig(), kEpoch, collected.issues),
               std::runtime_error);
  files.pictures = folder / "absent";
  EXPECT_THROW(open_video_recording(files, small_rig(), kEpoch, collected.issues),
               std::runtime_error);
}

}  // namespace
}  // namespace gastronaut
