#include "import/tum_folder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "import_fixtures.hpp"

namespace gastronaut {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Pair;

constexpr double kDepthStd = 0.01;

TEST(Associate, EachIsTheOthersNearestWithinTheLimit) {
  EXPECT_THAT(associate({0, 100, 200, 900}, {90, 110, 210, 500}, 20),
              ElementsAre(Pair(1, 0), Pair(2, 2)));
  EXPECT_TRUE(associate({0}, {}, 20).empty());
  EXPECT_TRUE(associate({}, {0}, 20).empty());
}

TEST(TumFolder, DepthComesWithTheColourPictureOfItsTime) {
  const ScratchFolder folder;
  RigConfiguration rig;
  rig.camera.width = 48;
  rig.camera.height = 32;
  rig.camera.cx = 23.5;
  rig.camera.cy = 15.5;
  std::filesystem::create_directory(folder / "rgb");
  std::filesystem::create_directory(folder / "depth");
  cv::imwrite(folder / "rgb/a.png", cv::Mat(32, 48, CV_8UC3, cv::Scalar(1, 2, 3)));
  cv::imwrite(folder / "rgb/b.png", cv::Mat(32, 48, CV_8UC3, cv::Scalar(4, 5, 6)));
  cv::imwrite(folder / "depth/a.png", cv::Mat(32, 48, CV_16UC1, cv::Scalar(5000)));
  folder.write("rgb.txt", "# timestamp filename\n100.000 rgb/a.png\n100.033 rgb/b.png\nbroken\n");
  folder.write("depth.txt", "100.005 depth/a.png\n");
  folder.write("groundtruth.txt",
               "98.5 0 0 0 0 0 0 1\n99.5 1 0 0 0 0 0 1\n100 2 0 0 0 0 0 1\n102 3 0 0 0 0 0 1\n");
  CollectedIssues collected;
  Recording recording = open_tum_folder(folder.path(), rig, kDepthStd, collected.issues);
  EXPECT_EQ(recording.depth_kind, DepthKind::kSensor);
  const auto first = recording.frames->next(collected.issues);
  const auto second = recording.frames->next(collected.issues);
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->utime, 100'000'000);
  EXPECT_EQ(first->depth, std::vector<std::uint16_t>(48 * 32, 5000));
  EXPECT_EQ(second->utime, 100'033'000);
  EXPECT_TRUE(second->depth.empty());
  EXPECT_FALSE(recording.frames->next(collected.issues));
  // Poses over a second from every picture are not part of this recording.
  ASSERT_EQ(recording.poses.size(), 2U);
  EXPECT_EQ(recording.poses[0].utime, 99'500'000);
  EXPECT_THAT(collected.list, ElementsAre(HasSubstr("rgb.txt:4: not a time and a file")));
}

TEST(TumFolder, WithoutAListOfPicturesItSaysWhatItExpects) {
  const ScratchFolder folder;
  CollectedIssues collected;
  try {
    open_tum_folder(folder.path(), {}, kDepthStd, collected.issues);
    FAIL() << "an empty folder was taken";
  } catch (const std::runtime_error& problem) {
    EXPECT_THAT(problem.what(), HasSubstr("rgb.txt is missing; expected a TUM RGB-D folder"));
  }
}

}  // namespace
}  // namespace gastronaut
