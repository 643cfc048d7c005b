#include "configuration/rig_configuration.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

namespace gastronaut {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::string error_of(const std::string& yaml, const std::vector<std::string>& settings = {}) {
  try {
    parse_rig_configuration(yaml, "rig.yaml", settings);
  } catch (const ConfigurationError& error) {
    return error.what();
  }
  return "no error";
}

TEST(RigConfiguration, MissingKeysKeepTheirDefaults) {
  const RigConfiguration read = parse_rig_configuration("name: lab\n", "rig.yaml");
  EXPECT_EQ(read.name, "lab");
  EXPECT_EQ(read.hall_array.rows, RigConfiguration().hall_array.rows);
}

TEST(RigConfiguration, UnitsBecomeSi) {
  const RigConfiguration read = parse_rig_configuration(
      "hall_array: {pitch: 22 mm, noise: 1.5uT, z: -8.5 cm}\nlights: {phase: 180 deg}\n",
      "rig.yaml");
  EXPECT_DOUBLE_EQ(read.hall_array.pitch, 0.022);
  EXPECT_DOUBLE_EQ(read.hall_array.noise, 1.5e-6);
  EXPECT_DOUBLE_EQ(read.hall_array.z, -0.085);
  EXPECT_DOUBLE_EQ(read.lights.phase, 3.14159265358979323846);
}

TEST(RigConfiguration, WhatIsWrittenReadsBackTheSame) {
  RigConfiguration written;
  written.hall_array.noise = 0.1 + 0.2;
  written.coils.tesla_per_ampere = Eigen::MatrixXd::Random(192, 9) / 3;
  written.camera.distortion = {-0.12, 1.0 / 3};
  written.camera.model = LensModel::kFisheye;
  HallSensorConfiguration sensor;
  sensor.position = {0.1, 0.2, 1.0 / 7};
  sensor.offset = {1e-6, 2e-6, -1.0 / 3e6};
  written.hall_array.sensors.assign(64, sensor);
  const std::string yaml = write_configuration(written);
  const RigConfiguration read = parse_rig_configuration(yaml, "written");
  EXPECT_EQ(write_configuration(read), yaml);
  EXPECT_EQ(read.hall_array.noise, written.hall_array.noise);
  EXPECT_EQ(read.coils.tesla_per_ampere, written.coils.tesla_per_ampere);
  EXPECT_EQ(read.hall_array.sensors[63].offset, sensor.offset);
  EXPECT_EQ(read.camera.model, LensModel::kFisheye);
}

TEST(RigConfiguration, UnknownKeyIsNamedWithLineAndTheLikelyOne) {
  EXPECT_THAT(error_of("name: a\nhall_array:\n  picth: 0.02\n"),
              AllOf(HasSubstr("rig.yaml:3:"), HasSubstr("hall_array.picth"),
                    HasSubstr("did you mean 'pitch'")));
}

TEST(RigConfiguration, WrongUnitSaysWhichAreRight) {
  EXPECT_THAT(error_of("hall_array: {pitch: 22 uT}\n"),
              AllOf(HasSubstr("rig.yaml:1:"), HasSubstr("wrong unit"), HasSubstr("m, cm, mm")));
}

TEST(RigConfiguration, ImpossibleValueSaysWhatWouldBeRight) {
  EXPECT_THAT(error_of("camera: {fx: -3}\n"), HasSubstr("greater than 0"));
  EXPECT_THAT(error_of("camera: {fx: .nan}\n"), HasSubstr("is not a plain number"));
  EXPECT_THAT(error_of("hall_array: {rows: 2.5}\n"), HasSubstr("whole number"));
  EXPECT_THAT(error_of("hall_array: {num_axes: 2}\n"), HasSubstr("must be 1 or 3"));
  EXPECT_THAT(error_of("camera_T_magnet: {rotation: [1, 1, 0, 0]}\n"),
              HasSubstr("unit quaternion"));
  EXPECT_THAT(error_of("camera: {cx: 5000}\n"), HasSubstr("principal point"));
  EXPECT_THAT(error_of("camera: {model: pinhole}\n"), HasSubstr("radial_tangential, fisheye"));
  EXPECT_THAT(error_of("coils: {tesla_per_ampere: [[1, 2]]}\n"), HasSubstr("192 channels"));
  EXPECT_THAT(error_of("magnet: {inner_radius: 9 mm}\n"), HasSubstr("outer_radius"));
}

TEST(RigConfiguration, RaggedMatrixNamesTheRow) {
  EXPECT_THAT(error_of("coils: {tesla_per_ampere: [[1, 2], [3]]}\n"), HasSubstr("row 2"));
}

TEST(RigConfiguration, KeyGivenTwiceIsRefused) {
  EXPECT_THAT(error_of("name: a\nname: b\n"), HasSubstr("given twice"));
}

TEST(RigConfiguration, BrokenYamlNamesLineAndColumn) {
  EXPECT_THAT(error_of("name: a\ncamera: {fx: [}\n"), HasSubstr("rig.yaml:2:"));
}

TEST(RigConfiguration, SettingsOverrideTogether) {
  const RigConfiguration read =
      parse_rig_configuration("camera: {width: 640, cx: 320}\n", "rig.yaml",
                              {"camera.width=320", "camera.cx=160", "hall_array.noise=2 uT"});
  EXPECT_EQ(read.camera.width, 320);
  EXPECT_DOUBLE_EQ(read.hall_array.noise, 2e-6);
}

TEST(RigConfiguration, WrongSettingsAreNamed) {
  EXPECT_THAT(error_of("", {"camera.fxx=3"}), HasSubstr("did you mean 'fx'"));
  EXPECT_THAT(error_of("", {"camera.fx"}), HasSubstr("section.key=value"));
  EXPECT_THAT(error_of("", {"=3"}), HasSubstr("section.key=value"));
}

TEST(RigConfiguration, LaterFilesOverrideEarlierOnesKeyByKey) {
  const std::string base = ::testing::TempDir() + "rig_configuration_base.yaml";
  const std::string over = ::testing::TempDir() + "rig_configuration_over.yaml";
  std::ofstream(base) << "name: base\nmagnet: {moment: 0.5, moment_std: 0.01}\n";
  std::ofstream(over) << "magnet: {moment: 0.6}\n";
  const RigConfiguration read = load_rig_configuration({base, over}, {});
  EXPECT_EQ(read.name, "base");
  EXPECT_DOUBLE_EQ(read.magnet.moment, 0.6);
  EXPECT_DOUBLE_EQ(read.magnet.moment_std, 0.01);
}

TEST(RigConfiguration, MissingFileIsAClearError) {
  EXPECT_THROW(load_rig_configuration({"/no/such/file.yaml"}, {}), ConfigurationError);
}

TEST(RigConfiguration, GridIsSpelledOutAsTheCaptureFolderSays) {
  const auto sensors = HallArrayConfiguration().resolved_sensors();
  ASSERT_EQ(sensors.size(), 64U);
  EXPECT_TRUE(sensors[8 * 2 + 5].position.isApprox(
      Eigen::Vector3d((2 - 3.5) * 0.022, (5 - 3.5) * 0.022, 0.085)));
}

TEST(RigConfiguration, PerceptionThatMakesNoSenseIsRefusedInWords) {
  const auto refusal = [](const std::string& yaml) -> std::string {
    try {
      parse_rig_configuration(yaml, "test");
    } catch (const ConfigurationError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(refusal("depth_estimator: {albedo: [0.8, 0.4]}"), HasSubstr("three numbers"));
  EXPECT_THAT(refusal("depth_estimator: {albedo: [0.8, 0, 0.4]}"), HasSubstr("three numbers"));
  EXPECT_THAT(refusal("depth_estimator: {vessel_scales: []}"), HasSubstr("vessel_scales"));
  EXPECT_THAT(refusal("depth_estimator: {vessel_scales: [0.1]}"), HasSubstr("vessel_scales"));
  EXPECT_THAT(refusal("depth_estimator: {min_depth: 2 cm, max_depth: 1 cm}"),
              HasSubstr("min_depth must be below max_depth"));
  EXPECT_THAT(refusal("depth_estimator: {curvature_radius: 2 m}"), HasSubstr("curvature_radius"));
  EXPECT_THAT(refusal("camera: {width: 640, height: 1, cy: 0}"), HasSubstr("max_width"));
  EXPECT_THAT(refusal("camera: {response: [0, 0.5]}"), HasSubstr("response"));
  EXPECT_THAT(refusal("camera: {response: [0, 0.5, 0.4, 1]}"), HasSubstr("response must grow"));
  EXPECT_EQ(refusal("camera: {response: [0, 0.2, 1]}\ndepth_estimator: {max_width: 640}"), "");
}

TEST(RigConfiguration, NamesOfCanSignalsMustTellSensorsAxesAndCoilsApart) {
  const auto error = [](const std::string& field) {
    return error_of("can_hall_array: {" + field + "}\n");
  };
  EXPECT_EQ(error("field_signal: 'B{axis}_{sensor}', status_signal: '', current_signal: ''"),
            "no error");
  EXPECT_THAT(error("field_signal: 'B{sensor}'"), HasSubstr("{sensor} and {axis}"));
  EXPECT_THAT(error("status_signal: state"), HasSubstr("status_signal must have {sensor}"));
  EXPECT_THAT(error("current_signal: 'I{sensor}'"), HasSubstr("current_signal must have {coil}"));
  EXPECT_THAT(error("counter_signal: ''"), HasSubstr("counter_signal must not be empty"));
  EXPECT_THAT(error("timeout: 20 mm"), HasSubstr("can_hall_array.timeout"));
}

}  // namespace
}  // namespace gastronaut
