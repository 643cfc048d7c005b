// `calibrate hand-eye` itself, on logs written here.
#include <gmock/gmock.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "bus/log_file.hpp"
#include "calibrate/hand_eye_motion.hpp"
#include "configuration/rig_configuration.hpp"
#include "gastronaut/magnetic_pose_t.hpp"
#include "gastronaut/rig_config_t.hpp"
#include "gastronaut/visual_pose_t.hpp"
#include "process/channels.hpp"
#include "unit/procs/calibrate/hand_eye_simulation.hpp"
#include "unit/procs/calibrate/program_folder.hpp"

namespace gastronaut {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class CalibrateHandEye : public ProgramFolder {
 protected:
  CalibrateHandEye() : ProgramFolder("calibrate_hand_eye") {}

  static std::int64_t utime(double time) {
    return 1'700'000'000'000'000 + static_cast<std::int64_t>(std::llround(time * 1e6));
  }
  static visual_pose_t message(const VisualFrame& frame) {
    visual_pose_t pose{};
    pose.utime = utime(frame.time);
    Eigen::Map<Eigen::Vector3d>(pose.position) = frame.map_T_camera.translation;
    const Eigen::Quaterniond& q = frame.map_T_camera.rotation;
    Eigen::Map<Eigen::Vector4d>(pose.orientation) << q.w(), q.x(), q.y(), q.z();
    return pose;
  }
  static magnetic_pose_t message(const MagneticFix& fix) {
    magnetic_pose_t pose{};
    pose.utime = utime(fix.time);
    Eigen::Map<Eigen::Vector3d>(pose.position) = fix.position;
    Eigen::Map<Eigen::Vector3d>(pose.axis) = fix.axis;
    Eigen::Map<Matrix5d>(pose.covariance[0]) = fix.covariance;
    return pose;
  }
  // With, in between, what is not to be used: fixes and frames that say so, another map's frames
  // and a NaN.
  void write_log(const std::string& name, const SimulatedHandEye& run) const {
    LogWriter log(folder_ + "/" + name);
    rig_config_t config{};
    config.yaml = write_configuration(RigConfiguration());
    log.write(channel::kRigConfig, config);
    for (std::size_t i = 0; i < run.frames.size(); ++i) {
      visual_pose_t pose = message(run.frames[i]);
      if (i % 40 == 7) {
        pose.status = visual_pose_t::STATUS_LOST;
        pose.position[0] += 1;
      }
      if (i >= run.frames.size() - 20) {
        pose.map_version = 1;
        pose.position[1] -= 1;
      }
      log.write(channel::kVisualPose, pose);
    }
    for (std::size_t i = 0; i < run.fixes.size(); ++i) {
      magnetic_pose_t pose = message(run.fixes[i]);
      if (i % 10 == 3) {
        pose.status = magnetic_pose_t::STATUS_INTERFERENCE;
        pose.position[2] += 1;
      }
      if (i == 50) pose.axis[0] = std::nan("");
      log.write(channel::kMagneticPose, pose);
    }
    log.close();
  }
  int run(const std::string& arguments) const {
    return run_program("calibrate hand-eye " + arguments);
  }
};

TEST_F(CalibrateHandEye, WritesAFragmentThatLoadsAndATableToBelieve) {
  HandEye truth = true_hand_eye();
  truth.time_offset = 0.02;
  write_log("derived.lcmlog", swinging(truth, 12, {}, {}, 1));
  ASSERT_EQ(run("derived.lcmlog --out hand_eye.yaml"), 0) << read("err.txt");
  EXPECT_THAT(read("err.txt"),
              AllOf(HasSubstr("the visual map has 2 versions"), HasSubstr("impossible messages"),
                    HasSubstr("left out for their status: 120 of")));
  EXPECT_THAT(read("out.txt"),
              AllOf(HasSubstr("magnet's centre in the camera"), HasSubstr("visual map in the rig"),
                    HasSubstr("weakest"), HasSubstr("leaving out one of 20")));
  EXPECT_THAT(read("hand_eye.yaml"),
              AllOf(HasSubstr("# Made by `calibrate hand-eye` from derived.lcmlog"),
                    HasSubstr("roll about the magnet's axis cannot be measured")));

  const RigConfiguration rig = load_rig_configuration({folder_ + "/hand_eye.yaml"}, {});
  const SE3 camera_T_magnet = rig.camera_T_magnet.transform();
  const Eigen::Vector3d axis = camera_T_magnet.rotation * Eigen::Vector3d::UnitZ();
  EXPECT_LT((camera_T_magnet.translation - truth.centre).norm(), kCentreTarget);
  EXPECT_LT(axis.cross(truth.axis).norm(), kAxisTarget);
  EXPECT_GT(axis.dot(truth.axis), 0);
  EXPECT_GT(rig.sensor_fusion.hand_eye_position_std, 0);
  EXPECT_LT(rig.sensor_fusion.hand_eye_position_std, kCentreTarget);
  EXPECT_GT(rig.sensor_fusion.hand_eye_axis_std, 0);
  EXPECT_LT(rig.sensor_fusion.hand_eye_axis_std, kAxisTarget);
  constexpr double kFourSigmas = 4;
  EXPECT_NEAR(rig.sensor_fusion.magnetic_time_offset, truth.time_offset,
              kFourSigmas * rig.sensor_fusion.magnetic_time_offset_std);
}

TEST_F(CalibrateHandEye, GivesTheSameBytesTwice) {
  write_log("derived.lcmlog", swinging(true_hand_eye(), 10, {}, {}, 2));
  ASSERT_EQ(run("derived.lcmlog --out one.yaml"), 0) << read("err.txt");
  ASSERT_EQ(run("derived.lcmlog --out two.yaml"), 0);
  EXPECT_EQ(read("one.yaml"), read("two.yaml"));
}

TEST_F(CalibrateHandEye, RefusesWithExitStatusOneAndSaysWhatToDo) {
  SimulatedHandEye still = swinging(true_hand_eye(), 10, {}, {}, 3);
  for (VisualFrame& frame : still.frames) frame.map_T_camera = still.frames.front().map_T_camera;
  write_log("still.lcmlog", still);
  EXPECT_EQ(run("still.lcmlog --out hand_eye.yaml"), 1);
  EXPECT_THAT(read("err.txt"), HasSubstr("rotate it about the camera's x, y and z axes"));
  SimulatedHandEye blind = swinging(true_hand_eye(), 10, {}, {}, 3);
  blind.frames.clear();
  LogWriter log(folder_ + "/blind.lcmlog");
  for (const MagneticFix& fix : blind.fixes) log.write(channel::kMagneticPose, message(fix));
  log.close();
  EXPECT_EQ(run("blind.lcmlog --out hand_eye.yaml"), 1);
  EXPECT_THAT(read("err.txt"), AllOf(HasSubstr("VISUAL_POSE"), HasSubstr("replay RAW")));
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/hand_eye.yaml"));
}

TEST_F(CalibrateHandEye, RefusesWrongUsageWithExitStatusTwo) {
  EXPECT_EQ(run("nothing.lcmlog --out hand_eye.yaml"), 2);
  EXPECT_EQ(run("--help"), 0);
  EXPECT_THAT(read("out.txt"), HasSubstr("Example: replay raw.lcmlog"));
}

}  // namespace
}  // namespace gastronaut
