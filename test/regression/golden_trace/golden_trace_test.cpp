// A short recording made with stock lcm-logger (raw.lcmlog) against what the processes once made of
// it (expected.csv) and against the truth in it. scripts/update_golden_trace renews both files on
// purpose; a change to expected.csv is part of the review.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <map>
#include <sstream>
#include <vector>

#include "bus/log_file.hpp"
#include "geometry/se3.hpp"
#include "process/channels.hpp"
#include "process/log_run.hpp"
#include "replay/replay.hpp"

namespace gastronaut {
namespace {

// Another compiler or mathematics library may round differently; a fix repeats far better than it
// is accurate. A changed algorithm moves it by more than this.
constexpr double kPositionTolerance = 1e-7;  // metres
constexpr double kAxisTolerance = 1e-6;      // radians
// targets.md asks for 0.5 mm and 1 degree of a calibrated array within 5 cm; this rig is neither
// calibrated nor that near, so the trace is held to the off-the-shelf fit's 0.9 mm RMS times three.
constexpr double kLargestPositionError = 2.7e-3;  // metres

struct Fix {
  std::int64_t utime = 0;
  int status = 0;
  Eigen::Vector3d position;
  Eigen::Vector3d axis;
};

const std::filesystem::path kFolder =
    std::filesystem::path(GASTRONAUT_SOURCE_DIR) / "test/regression/golden_trace";

Fix to_fix(const magnetic_pose_t& message) {
  return {message.utime, message.status, Eigen::Vector3d(message.position),
          Eigen::Vector3d(message.axis)};
}

struct Trace {
  std::vector<Fix> fixes;
  std::map<std::int64_t, SE3> truth;  // rig_T_camera
  RigConfiguration configuration;
};

Trace replay_golden_trace() {
  LogRunOptions options;
  options.log_in = (kFolder / "raw.lcmlog").string();
  // A name of its own: ctest runs the tests of a program side by side.
  options.log_out = ::testing::TempDir() + "golden_trace_" +
                    ::testing::UnitTest::GetInstance()->current_test_info()->name() + ".lcmlog";
  run_on_log(all_processes(), options, {});
  Trace trace;
  LogReader reader(options.log_out);
  while (const auto event = reader.next()) {
    magnetic_pose_t fix;
    rigid_transform_t pose;
    rig_config_t configuration;
    if (event->channel == channel::kMagneticPose) {
      EXPECT_EQ(decode_message(event->payload, fix), DecodeResult::kOk);
      trace.fixes.push_back(to_fix(fix));
    } else if (event->channel == channel::kGroundTruthPose) {
      EXPECT_EQ(decode_message(event->payload, pose), DecodeResult::kOk);
      trace.truth[pose.utime] = {
          Eigen::Quaterniond(pose.quat[0], pose.quat[1], pose.quat[2], pose.quat[3]),
          Eigen::Vector3d(pose.trans)};
    } else if (event->channel == channel::kRigConfig) {
      EXPECT_EQ(decode_message(event->payload, configuration), DecodeResult::kOk);
      trace.configuration = parse_rig_configuration(configuration.yaml, "golden trace");
    }
  }
  std::filesystem::remove(options.log_out);
  return trace;
}

void write_expected(const std::vector<Fix>& fixes) {
  std::ofstream file(kFolder / "expected.csv");
  file << "utime,status,x,y,z,axis_x,axis_y,axis_z\n" << std::setprecision(12);
  for (const Fix& fix : fixes) {
    file << fix.utime << ',' << fix.status;
    for (const double value : fix.position) file << ',' << value;
    for (const double value : fix.axis) file << ',' << value;
    file << '\n';
  }
}

std::vector<Fix> read_expected() {
  std::ifstream file(kFolder / "expected.csv");
  std::vector<Fix> fixes;
  std::string line;
  std::getline(file, line);
  while (std::getline(file, line)) {
    std::istringstream row(line);
    Fix fix;
    char comma = 0;
    row >> fix.utime >> comma >> fix.status;
    for (double& value : fix.position) row >> comma >> value;
    for (double& value : fix.axis) row >> comma >> value;
    EXPECT_FALSE(row.fail()) << line;
    fixes.push_back(fix);
  }
  return fixes;
}

TEST(GoldenTrace, FixesAreWhatTheyWere) {
  const Trace trace = replay_golden_trace();
  if (std::getenv("GASTRONAUT_UPDATE_GOLDEN_TRACE") != nullptr) write_expected(trace.fixes);
  const std::vector<Fix> expected = read_expected();
  ASSERT_FALSE(expected.empty());
  ASSERT_EQ(trace.fixes.size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) {
    EXPECT_EQ(trace.fixes[i].utime, expected[i].utime);
    EXPECT_EQ(trace.fixes[i].status, expected[i].status) << "at " << expected[i].utime;
    EXPECT_LT((trace.fixes[i].position - expected[i].position).norm(), kPositionTolerance);
    EXPECT_LT((trace.fixes[i].axis - expected[i].axis).norm(), kAxisTolerance);
  }
}

TEST(GoldenTrace, FixesLieAtTheTruth) {
  const Trace trace = replay_golden_trace();
  const SE3 camera_T_magnet = trace.configuration.camera_T_magnet.transform();
  int compared = 0;
  for (const Fix& fix : trace.fixes) {
    const auto truth = trace.truth.find(fix.utime);
    if (truth == trace.truth.end() || fix.status != magnetic_pose_t::STATUS_OK) continue;
    const SE3 rig_T_magnet = truth->second * camera_T_magnet;
    EXPECT_LT((fix.position - rig_T_magnet.translation).norm(), kLargestPositionError);
    ++compared;
  }
  constexpr int kAtLeast = 20;  // a second of frames
  EXPECT_GE(compared, kAtLeast);
}

}  // namespace
}  // namespace gastronaut
