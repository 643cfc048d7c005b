// The peers' own figures on the same files, to the precision in which they are printed: evo's
// stored results for KITTI, the TUM benchmark's scripts for the rest (SOURCE.txt beside the data).
#include "evaluate/trajectory_comparison.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

namespace gastronaut::evaluation {
namespace {

constexpr double kTenDecimals = 0.5e-10;
constexpr double kSixDecimals = 0.5e-6;

std::string trajectory_folder() {
  const char* data = std::getenv("GASTRONAUT_DATA");
  return (data != nullptr ? std::string(data) : GASTRONAUT_SOURCE_DIR "/../shared/data") +
         "/trajectories/";
}

class PeerTest : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(trajectory_folder())) {
      GTEST_SKIP() << "NOT TESTED: no " << trajectory_folder()
                   << "; set GASTRONAUT_DATA to the folder with the shared data";
    }
  }

  // Value of one figure.
  static double value(const ComparedTrajectories& compared, const std::string& key) {
    for (const auto& [name, number] : compared.metrics.list()) {
      if (name != key) continue;
      if (std::holds_alternative<std::int64_t>(number)) {
        return static_cast<double>(std::get<std::int64_t>(number));
      }
      return std::get<double>(number);
    }
    ADD_FAILURE() << "no figure named " << key;
    return 0;
  }

  static ComparedTrajectories kitti(const std::string& estimate) {
    TrajectoryComparison comparison;
    comparison.estimate = trajectory_folder() + estimate;
    comparison.truth = trajectory_folder() + "KITTI_00_gt.txt";
    comparison.format = TrajectoryFormat::kKitti;
    comparison.delta = "10m";
    return compare_trajectories(comparison);
  }

  static ComparedTrajectories tum(const std::string& estimate, const std::string& truth) {
    TrajectoryComparison comparison;
    comparison.estimate = trajectory_folder() + estimate;
    comparison.truth = trajectory_folder() + truth;
    comparison.max_difference = 0.02;  // the benchmark's default
    comparison.delta = "1s";
    return compare_trajectories(comparison);
  }
};

TEST_F(PeerTest, KittiOrbEqualsEvo) {
  const ComparedTrajectories orb = kitti("KITTI_00_ORB.txt");
  EXPECT_NEAR(value(orb, "ESTIMATE.ate.se3.rmse"), 1.3034497146, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.ate.se3.mean"), 1.1569971285, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.ate.se3.median"), 1.0656247696, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.ate.se3.std"), 0.6002822694, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.ate.se3.max"), 3.5879491207, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.ate.se3.min"), 0.0693132202, kTenDecimals);
  // From evo's stored statistics of the same run (res_files/orb_rpe.zip).
  EXPECT_NEAR(value(orb, "ESTIMATE.rpe.10m.trans.rmse"), 0.2262613433, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.rpe.10m.trans.mean"), 0.1690173720, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.rpe.10m.trans.median"), 0.1384843252, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.rpe.10m.trans.std"), 0.1504238127, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.rpe.10m.trans.max"), 1.2722090779, kTenDecimals);
  EXPECT_NEAR(value(orb, "ESTIMATE.rpe.10m.trans.min"), 0.0253227197, kTenDecimals);
}

TEST_F(PeerTest, KittiSptamEqualsEvo) {
  const ComparedTrajectories sptam = kitti("KITTI_00_SPTAM.txt");
  EXPECT_NEAR(value(sptam, "ESTIMATE.ate.se3.rmse"), 3.7384879076, kTenDecimals);
  EXPECT_NEAR(value(sptam, "ESTIMATE.ate.se3.mean"), 3.4909766331, kTenDecimals);
  EXPECT_NEAR(value(sptam, "ESTIMATE.ate.se3.median"), 3.6425846417, kTenDecimals);
  EXPECT_NEAR(value(sptam, "ESTIMATE.ate.se3.max"), 7.7689774066, kTenDecimals);
  EXPECT_NEAR(value(sptam, "ESTIMATE.rpe.10m.trans.rmse"), 0.2760710904, kTenDecimals);
  EXPECT_NEAR(value(sptam, "ESTIMATE.rpe.10m.trans.mean"), 0.2228479791, kTenDecimals);
}

TEST_F(PeerTest, TumRgbdslamEqualsTheBenchmarkScripts) {
  const ComparedTrajectories xyz =
      tum("freiburg1_xyz-rgbdslam.txt", "freiburg1_xyz-groundtruth.txt");
  EXPECT_EQ(value(xyz, "ESTIMATE.with_truth"), 786);
  EXPECT_NEAR(value(xyz, "ESTIMATE.ate.se3.rmse"), 0.013473, kSixDecimals);
  EXPECT_NEAR(value(xyz, "ESTIMATE.ate.se3.mean"), 0.012029, kSixDecimals);
  EXPECT_NEAR(value(xyz, "ESTIMATE.ate.se3.median"), 0.011176, kSixDecimals);
  EXPECT_NEAR(value(xyz, "ESTIMATE.ate.se3.std"), 0.006068, kSixDecimals);
  EXPECT_NEAR(value(xyz, "ESTIMATE.ate.se3.max"), 0.034727, kSixDecimals);
  EXPECT_EQ(value(xyz, "ESTIMATE.rpe.1s.count"), 753);
  EXPECT_NEAR(value(xyz, "ESTIMATE.rpe.1s.trans.rmse"), 0.021217, kSixDecimals);
  EXPECT_NEAR(value(xyz, "ESTIMATE.rpe.1s.trans.mean"), 0.019524, kSixDecimals);
  EXPECT_NEAR(value(xyz, "ESTIMATE.rpe.1s.rot_deg.rmse"), 0.934480, kSixDecimals);
  EXPECT_NEAR(value(xyz, "ESTIMATE.rpe.1s.rot_deg.mean"), 0.841472, kSixDecimals);
}

TEST_F(PeerTest, TumDeskOrbEqualsTheBenchmarkScripts) {
  const ComparedTrajectories desk = tum("fr2_desk_ORB.txt", "fr2_desk_groundtruth.txt");
  EXPECT_EQ(value(desk, "ESTIMATE.with_truth"), 2223);
  EXPECT_NEAR(value(desk, "ESTIMATE.ate.se3.rmse"), 0.008144, kSixDecimals);
  EXPECT_NEAR(value(desk, "ESTIMATE.ate.se3.mean"), 0.007514, kSixDecimals);
  EXPECT_NEAR(value(desk, "ESTIMATE.ate.se3.max"), 0.024329, kSixDecimals);
}

TEST_F(PeerTest, RecordingsOfDifferentTimesAreRefused) {
  EXPECT_THROW(tum("fr2_desk_ORB.txt", "freiburg1_xyz-groundtruth.txt"), std::runtime_error);
}

}  // namespace
}  // namespace gastronaut::evaluation
