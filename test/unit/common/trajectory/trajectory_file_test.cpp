#include "trajectory/trajectory_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "numerics/counter_random.hpp"

namespace gastronaut {
namespace {

using testing::HasSubstr;

std::string file_with(const std::string& text) {
  const std::string path =
      testing::TempDir() + "/trajectory_" + std::to_string(getpid()) + "_test.txt";
  std::ofstream(path) << text;
  return path;
}

std::string problem_of(const std::string& text, TrajectoryFormat format) {
  try {
    read_trajectory(file_with(text), format);
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "";
}

TEST(TrajectoryFileTest, WhatIsWrittenIsReadBack) {
  const CounterRandom random(1, 0);
  std::uint64_t draw = 0;
  const auto vector = [&](double sigma) {
    const Eigen::Vector3d standard(random.normal(draw), random.normal(draw + 1),
                                   random.normal(draw + 2));
    draw += 3;
    return Eigen::Vector3d(sigma * standard);
  };
  StampedPoses trajectory;
  for (std::int64_t i = 0; i < 20; ++i) {
    trajectory.utimes.push_back(1305031102160407 + 33333 * i);
    trajectory.poses.push_back(to_pose({so3_exp(vector(1)), vector(2)}));
  }
  const std::string path = testing::TempDir() + "/evaluate_round_trip.tum";
  write_tum(path, trajectory);
  const StampedPoses read = read_trajectory(path, TrajectoryFormat::kTum);
  EXPECT_EQ(read.utimes, trajectory.utimes);
  constexpr double kNineDecimals = 5e-9;  // half of the last one, times what a rotation adds up
  for (std::size_t i = 0; i < read.size(); ++i) {
    EXPECT_LT((read.poses[i].translation - trajectory.poses[i].translation).norm(), kNineDecimals);
    EXPECT_LT((read.poses[i].rotation - trajectory.poses[i].rotation).norm(), kNineDecimals);
  }
}

TEST(TrajectoryFileTest, PosesComeSortedAndOfOneTimeTheLastCounts) {
  const StampedPoses read = read_trajectory(file_with("# time x y z qx qy qz qw\n"
                                                      "2.5 3 0 0 0 0 0 1\n"
                                                      "\n"
                                                      "1.5,1,0,0,0,0,0,1\n"
                                                      "2.5 4 0 0 0 0 0 1\n"),
                                            TrajectoryFormat::kTum);
  EXPECT_EQ(read.utimes, (std::vector<std::int64_t>{1500000, 2500000}));
  EXPECT_EQ(read.poses[1].translation.x(), 4);
}

TEST(TrajectoryFileTest, WrongRowsAreNamedByFileAndLine) {
  const std::string good = "1 0 0 0 0 0 0 1\n";
  EXPECT_THAT(problem_of(good + "2 0 0 0 0 0 1\n", TrajectoryFormat::kTum),
              HasSubstr("_test.txt:2: 8 numbers expected, found 7"));
  EXPECT_THAT(problem_of(good + "2 0 0 zero 0 0 0 1\n", TrajectoryFormat::kTum),
              HasSubstr(":2: \"zero\" is not a number"));
  EXPECT_THAT(problem_of(good + "2 0 0 nan 0 0 0 1\n", TrajectoryFormat::kTum),
              HasSubstr(":2: \"nan\" is not a finite number"));
  EXPECT_THAT(problem_of(good + "2 0 0 0 0 0 0 2\n", TrajectoryFormat::kTum),
              HasSubstr(":2: columns 5 to 8 are not a unit quaternion"));
  EXPECT_THAT(problem_of("1 0 0 0 0 1 0 0 0 0 2 0\n", TrajectoryFormat::kKitti),
              HasSubstr(":1: the 3x3 part is not a rotation matrix"));
  EXPECT_THAT(problem_of("1 0 0 0 0 1 0 0 0 0 -1 0\n", TrajectoryFormat::kKitti),
              HasSubstr("not a rotation matrix"));
  EXPECT_THAT(problem_of("# nothing\n", TrajectoryFormat::kTum), HasSubstr("holds no pose"));
  EXPECT_THROW(read_trajectory("/nonexistent", TrajectoryFormat::kTum), std::runtime_error);
}

}  // namespace
}  // namespace gastronaut
