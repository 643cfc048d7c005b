#include "calibrate/calibration_report.hpp"

#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>

#include "array_simulation.hpp"

namespace gastronaut {
namespace {

using testing::HasSubstr;

class CalibrationReport : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = testing::TempDir() + "calibration_report_" + std::to_string(getpid());
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  // As a user would: the rig's own file, then the fragment.
  RigConfiguration load_with(const RigConfiguration& rig, const std::string& fragment) const {
    std::ofstream(folder_ + "/rig.yaml") << write_configuration(rig);
    std::ofstream(folder_ + "/fragment.yaml") << fragment;
    return load_rig_configuration({folder_ + "/rig.yaml", folder_ + "/fragment.yaml"}, {});
  }

  std::string folder_;
  const RigConfiguration rig_ = simulated_rig(3);
  const RigConfiguration truth_ = with_sensor_errors(rig_, {}, 11);
};

TEST_F(CalibrationReport, ArrayFragmentReadsBackToTheLastBit) {
  const auto readings = simulate(truth_, {wide_path, independent_currents});
  const ArrayCalibration calibration = calibrate_array(rig_, readings, {}, [](double) {});
  const std::string fragment = array_fragment(calibration, rig_, "sweep.lcmlog");
  EXPECT_EQ(write_configuration(load_with(rig_, fragment)), write_configuration(calibration.rig));
  EXPECT_THAT(fragment, HasSubstr("sweep.lcmlog"));
  EXPECT_THAT(fragment, HasSubstr("sensor 15: gain +-"));
}

TEST_F(CalibrationReport, CoilFragmentReadsBackToTheLastBit) {
  SimulatedRun run{nullptr, independent_currents};
  run.readings = 400;
  const CoilCalibration calibration =
      calibrate_coils(simulate(truth_, run), 3, Eigen::VectorXd::Constant(4, 0.002), rig_);
  Eigen::Vector3d background;
  const std::string fragment = coil_fragment(calibration, rig_, "empty.lcmlog");
  EXPECT_EQ(write_configuration(load_with(rig_, fragment)),
            write_configuration(with_coils(rig_, calibration, &background)));
  EXPECT_THAT(fragment, HasSubstr("empty.lcmlog"));
  EXPECT_THAT(fragment, HasSubstr("standard error"));
}

TEST_F(CalibrationReport, CoilFragmentWithoutARigHasTheMatrixAlone) {
  SimulatedRun run{nullptr, independent_currents};
  run.readings = 400;
  const CoilCalibration calibration =
      calibrate_coils(simulate(truth_, run), 3, Eigen::VectorXd::Constant(4, 0.002), std::nullopt);
  const RigConfiguration loaded =
      load_with(rig_, coil_fragment(calibration, std::nullopt, "empty.lcmlog"));
  EXPECT_EQ(loaded.coils.tesla_per_ampere, calibration.tesla_per_ampere);
  EXPECT_EQ(loaded.hall_array.sensors.front().offset, rig_.hall_array.sensors.front().offset);
}

}  // namespace
}  // namespace gastronaut
