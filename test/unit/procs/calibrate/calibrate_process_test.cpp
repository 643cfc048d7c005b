// The program itself, on logs written here.
#include <gmock/gmock.h>

#include <fstream>

#include "array_simulation.hpp"
#include "bus/log_file.hpp"
#include "gastronaut/coil_currents_t.hpp"
#include "gastronaut/hall_array_t.hpp"
#include "gastronaut/rig_config_t.hpp"
#include "gastronaut/rigid_transform_t.hpp"
#include "process/channels.hpp"
#include "unit/procs/calibrate/program_folder.hpp"

namespace gastronaut {
namespace {

using testing::HasSubstr;

class CalibrateProgram : public ProgramFolder {
 protected:
  CalibrateProgram() : ProgramFolder("calibrate_program") {}

  void write_log(const std::string& name, const SimulatedRun& run, bool with_truth) const {
    LogWriter log(folder_ + "/" + name);
    rig_config_t config{};
    config.name = rig_.name;
    config.yaml = write_configuration(rig_);
    log.write(channel::kRigConfig, config);
    for (const CalibrationReading& reading : simulate(truth_, run)) {
      coil_currents_t currents{};
      currents.utime = reading.utime;
      currents.num_coils = static_cast<std::int32_t>(reading.currents.size());
      for (const double current : reading.currents) {
        currents.current.push_back(static_cast<float>(current));
      }
      log.write(channel::kCoilCurrents, currents);
      hall_array_t hall{};
      hall.utime = reading.utime;
      hall.num_sensors = rig_.hall_array.num_sensors();
      hall.num_axes = rig_.hall_array.num_axes;
      hall.status.assign(static_cast<std::size_t>(hall.num_sensors), hall_array_t::STATUS_OK);
      for (Eigen::Index s = 0; s < hall.num_sensors; ++s) {
        hall.field.emplace_back();
        for (Eigen::Index axis = 0; axis < hall.num_axes; ++axis) {
          hall.field.back().push_back(static_cast<float>(reading.field(s * hall.num_axes + axis)));
        }
      }
      log.write(channel::kHallArray, hall);
      if (!with_truth) continue;
      // The magnet sits at the camera's centre, turned as camera_T_magnet says: not at all.
      const MagnetPose pose = run.path(static_cast<double>(reading.utime) / 1e4 / run.readings);
      const auto turn = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), pose.axis);
      rigid_transform_t truth{};
      truth.utime = reading.utime;
      Eigen::Map<Eigen::Vector3d>(truth.trans) = pose.position;
      Eigen::Map<Eigen::Vector4d>(truth.quat) << turn.w(), turn.x(), turn.y(), turn.z();
      log.write(channel::kGroundTruthPose, truth);
    }
    log.close();
  }

  int run(const std::string& arguments) const { return run_program("calibrate " + arguments); }

  const RigConfiguration rig_ = simulated_rig(3);
  const RigConfiguration truth_ = with_sensor_errors(rig_, {}, 21);
};

TEST_F(CalibrateProgram, CalibratesCoilsFromALog) {
  write_log("empty.lcmlog", {nullptr, independent_currents, {18e-6, -6e-6, -42e-6}, 300}, false);
  ASSERT_EQ(run("coils empty.lcmlog --out coils.yaml"), 0) << read("err.txt");
  EXPECT_THAT(read("out.txt"), HasSubstr("standard error"));
  std::ofstream(folder_ + "/rig.yaml") << write_configuration(rig_);
  const RigConfiguration rig =
      load_rig_configuration({folder_ + "/rig.yaml", folder_ + "/coils.yaml"}, {});
  constexpr double kRelative = 0.01;
  EXPECT_TRUE(rig.coils.tesla_per_ampere.isApprox(truth_.coils.tesla_per_ampere, kRelative));
}

TEST_F(CalibrateProgram, CalibratesTheArrayWithKnownAndUnknownPosesAlike) {
  write_log("sweep.lcmlog", {wide_path, independent_currents}, true);
  ASSERT_EQ(run("array sweep.lcmlog --out known.yaml"), 0) << read("err.txt");
  EXPECT_THAT(read("err.txt"), HasSubstr("known (GROUND_TRUTH_POSE)"));
  ASSERT_EQ(run("array sweep.lcmlog --poses unknown --out unknown.yaml"), 0) << read("err.txt");
  EXPECT_THAT(read("err.txt"), HasSubstr("unknown"));
  std::ofstream(folder_ + "/rig.yaml") << write_configuration(rig_);
  const auto known = load_rig_configuration({folder_ + "/rig.yaml", folder_ + "/known.yaml"}, {});
  const auto unknown =
      load_rig_configuration({folder_ + "/rig.yaml", folder_ + "/unknown.yaml"}, {});
  constexpr double kFourSigmas = 4;
  EXPECT_NEAR(known.magnet.moment, unknown.magnet.moment, kFourSigmas * unknown.magnet.moment_std);
  EXPECT_LE(known.hall_array.gain_std, unknown.hall_array.gain_std);
}

TEST_F(CalibrateProgram, RefusesWithExitStatusOneAndWritesNothing) {
  write_log("sweep.lcmlog", {wide_path, independent_currents}, false);
  EXPECT_EQ(run("coils sweep.lcmlog --out coils.yaml"), 1);
  EXPECT_THAT(read("err.txt"), HasSubstr("Take it away and record again"));
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/coils.yaml"));
  EXPECT_EQ(run("array sweep.lcmlog --poses known --out array.yaml"), 1);
  EXPECT_THAT(read("err.txt"), HasSubstr("--poses unknown"));
}

TEST_F(CalibrateProgram, RefusesWrongUsageWithExitStatusTwo) {
  EXPECT_EQ(run("array nothing.lcmlog --out array.yaml"), 2);
  EXPECT_EQ(run("lamp"), 2);
  EXPECT_EQ(run("--help"), 0);
  EXPECT_THAT(read("out.txt"), HasSubstr("coils"));
  EXPECT_EQ(run("array --help"), 0);
  EXPECT_THAT(read("out.txt"), HasSubstr("Example: calibrate array"));
}

}  // namespace
}  // namespace gastronaut
