#include "virtual_rig/magnetic_rig.hpp"

#include <gtest/gtest.h>

#include "magnetics/dipole.hpp"
#include "small_scenario.hpp"

namespace gastronaut {
namespace {

// Of 192 normal numbers hardly one lies further out: the seeds are fixed, so it never flickers.
constexpr double kSigmas = 5;

VirtualRigScenario exact_scenario() {
  VirtualRigScenario scenario = small_scenario();
  scenario.rig.magnet.outer_radius = scenario.rig.magnet.inner_radius = 0;
  scenario.rig.magnet.length = 0;
  MagneticsConfiguration& magnetics = scenario.magnetics;
  magnetics.gain_error = magnetics.alignment_error = magnetics.offset_error = 0;
  magnetics.moment_error = magnetics.matrix_error = magnetics.quantisation = 0;
  return scenario;
}

SE3 below_array() {
  return SE3::exp((Vector6d() << 0.01, -0.02, 0.005, 0.5, 0.9, -0.3).finished());
}

FaultConfiguration sensor_fault(FaultKind kind) {
  FaultConfiguration fault;
  fault.kind = kind;
  fault.start = 1;
  fault.end = 2;
  fault.sensors = {7};
  return fault;
}

TEST(MagneticRig, WithoutErrorsReadsDipoleCoilsAndBackground) {
  const VirtualRigScenario scenario = exact_scenario();
  MagneticRig rig(scenario);
  const SE3 pose = below_array();
  const double time = 3.7;
  const HallReading reading = rig.read(370, time, pose);
  const RigConfiguration published = rig.published_configuration();
  const Eigen::VectorXd coils = published.coils.tesla_per_ampere * rig.true_currents(time);
  const auto sensors = published.hall_array.resolved_sensors();
  for (std::size_t i = 0; i < sensors.size(); ++i) {
    const Eigen::Vector3d expected =
        dipole_field(sensors[i].position - pose.translation,
                     scenario.rig.magnet.moment * (pose.rotation * Eigen::Vector3d::UnitZ())) +
        scenario.magnetics.background + coils.segment<3>(3 * static_cast<Eigen::Index>(i));
    const Eigen::Vector3d measured = reading.field.segment<3>(3 * static_cast<Eigen::Index>(i));
    EXPECT_LT((measured - expected).cwiseAbs().maxCoeff(), kSigmas * scenario.rig.hall_array.noise);
    EXPECT_EQ(reading.status[i], 0);
  }
}

TEST(MagneticRig, TrueConfigurationExplainsWhatThePublishedOneDoesNot) {
  const VirtualRigScenario scenario = small_scenario();
  MagneticRig rig(scenario);
  const HallReading reading = rig.read(0, 0, std::nullopt);
  const auto worst = [&](const RigConfiguration& configuration) {
    const auto sensors = configuration.hall_array.resolved_sensors();
    Eigen::VectorXd expected = configuration.coils.tesla_per_ampere * rig.true_currents(0);
    for (std::size_t i = 0; i < sensors.size(); ++i) {
      expected.segment<3>(3 * static_cast<Eigen::Index>(i)) +=
          sensors[i].response * scenario.magnetics.background +
          Eigen::Vector3d::Map(sensors[i].offset.data());
    }
    return (reading.field - expected).cwiseAbs().maxCoeff();
  };
  const double noise = scenario.rig.hall_array.noise + scenario.magnetics.quantisation;
  EXPECT_LT(worst(rig.true_configuration()), kSigmas * noise);
  EXPECT_GT(worst(rig.published_configuration()), worst(rig.true_configuration()));
}

TEST(MagneticRig, ReadingsAreWholeCountsOfTheConverter) {
  const VirtualRigScenario scenario = small_scenario();
  const HallReading reading = MagneticRig(scenario).read(0, 0, below_array());
  constexpr double kRounding = 1e-9;  // of a count
  for (const double field : reading.field) {
    const double counts = field / scenario.magnetics.quantisation;
    EXPECT_NEAR(counts, std::round(counts), kRounding * std::abs(counts));
  }
}

TEST(MagneticRig, SaturatedSensorSitsAtFullScaleAndSaysSo) {
  VirtualRigScenario scenario = small_scenario();
  scenario.faults = {sensor_fault(FaultKind::kSaturatedSensor)};
  MagneticRig rig(scenario);
  const HallReading reading = rig.read(150, 1.5, below_array());
  EXPECT_EQ(reading.status[7], kSensorSaturated);
  EXPECT_EQ(reading.field[21], scenario.rig.hall_array.saturation);
  EXPECT_EQ(reading.status[8], 0);
  EXPECT_EQ(rig.read(250, 2.5, below_array()).status[7], 0);
}

TEST(MagneticRig, FieldBeyondFullScaleIsClippedAndMarked) {
  VirtualRigScenario scenario = small_scenario();
  scenario.rig.hall_array.saturation = 2e-5;  // less than the background
  const HallReading reading = MagneticRig(scenario).read(0, 0, std::nullopt);
  EXPECT_EQ(reading.status[0], kSensorSaturated);
  EXPECT_LE(reading.field.cwiseAbs().maxCoeff(), scenario.rig.hall_array.saturation);
}

TEST(MagneticRig, StuckSensorRepeatsItselfSilentlyAndStaleOneSaysSo) {
  VirtualRigScenario scenario = small_scenario();
  scenario.faults = {sensor_fault(FaultKind::kStuckSensor), sensor_fault(FaultKind::kStaleSensor)};
  scenario.faults[1].sensors = {8};
  MagneticRig rig(scenario);
  const HallReading before = rig.read(99, 0.99, below_array());
  HallReading during;
  for (int i = 100; i < 110; ++i) during = rig.read(i, i / 100.0, below_array());
  EXPECT_EQ(during.field.segment<6>(21), before.field.segment<6>(21));
  EXPECT_NE(during.field.segment<3>(0), before.field.segment<3>(0));
  EXPECT_EQ(during.status[7], 0);
  EXPECT_EQ(during.status[8], kSensorStale);
}

TEST(MagneticRig, ForeignFieldComesOnTop) {
  VirtualRigScenario scenario = small_scenario();
  FaultConfiguration fault;
  fault.kind = FaultKind::kForeignField;
  fault.start = 1;
  fault.end = 2;
  fault.position = {0.12, 0, 0.05};
  fault.moment = {0, 0, 1};
  MagneticRig quiet(scenario);
  scenario.faults = {fault};
  MagneticRig disturbed(scenario);
  const Eigen::VectorXd difference =
      disturbed.read(150, 1.5, below_array()).field - quiet.read(150, 1.5, below_array()).field;
  const auto sensors = disturbed.true_configuration().hall_array.resolved_sensors();
  for (std::size_t i = 0; i < sensors.size(); ++i) {
    const Eigen::Vector3d expected =
        sensors[i].response * dipole_field(sensors[i].position - fault.position, fault.moment);
    const Eigen::Vector3d got = difference.segment<3>(3 * static_cast<Eigen::Index>(i));
    EXPECT_LE((got - expected).cwiseAbs().maxCoeff(), scenario.magnetics.quantisation);
  }
}

TEST(MagneticRig, LoweredMagnetIsHardlyHeard) {
  VirtualRigScenario scenario = small_scenario();
  FaultConfiguration fault;
  fault.kind = FaultKind::kMagnetFar;
  fault.start = 1;
  fault.end = 2;
  fault.strength = 1;
  scenario.faults = {fault};
  MagneticRig rig(scenario);
  // Without coils' and background's share: against a rig without a magnet, same noise.
  MagneticRig empty(scenario);
  const auto heard = [&](std::int64_t index, double time) {
    return (rig.read(index, time, below_array()).field -
            empty.read(index, time, std::nullopt).field)
        .norm();
  };
  // 1.08 m against 0.08 m and r^-3; what is left is quantisation.
  EXPECT_LT(heard(150, 1.5), heard(50, 0.5) / 100);
}

}  // namespace
}  // namespace gastronaut
