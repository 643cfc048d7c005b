#include "virtual_rig/scenario.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

namespace gastronaut {
namespace {

using ::testing::HasSubstr;

const std::string kFolder = std::string(GASTRONAUT_SOURCE_DIR) + "/config/scenarios/";

std::string refusal(const std::vector<std::string>& settings) {
  try {
    load_scenario(kFolder + "st0.yaml", settings);
  } catch (const ConfigurationError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(Scenario, EveryShippedOneLoads) {
  int loaded = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kFolder)) {
    EXPECT_NO_THROW(load_scenario(entry.path().string(), {})) << entry.path();
    ++loaded;
  }
  EXPECT_GT(loaded, 0);
}

TEST(Scenario, CameraFileOverridesTheRigsAndSettingsOverrideBoth) {
  const auto by_file = load_scenario(kFolder + "st1.yaml", {});
  EXPECT_EQ(by_file.rig.camera.width, 640);
  EXPECT_EQ(by_file.rig.magnet.outer_radius, 0.0055);  // from the rig's file
  const auto set =
      load_scenario(kFolder + "st1.yaml",
                    {"rig.camera.rate=30Hz", "camera_file=../cameras/capsule_250x250.yaml"});
  EXPECT_EQ(set.rig.camera.width, 250);
  EXPECT_EQ(set.rig.camera.rate, 30);
}

TEST(Scenario, RefusalsSayWhatWouldBeRight) {
  EXPECT_THAT(refusal({"trajectory.path_lenght=1"}), HasSubstr("did you mean 'path_length'"));
  EXPECT_THAT(refusal({"trajectory.kind=dance"}), HasSubstr("tour, static, absent"));
  EXPECT_THAT(refusal({"faults=[{kind: stuck_sensor, start: 1, end: 2}]"}), HasSubstr("'sensors'"));
  EXPECT_THAT(refusal({"faults=[{kind: stuck_sensor, start: 1, end: 2, sensors: [64]}]"}),
              HasSubstr("0 to 63"));
  EXPECT_THAT(refusal({"faults=[{kind: turbid, start: 2, end: 1, strength: 1}]"}),
              HasSubstr("after its start"));
  EXPECT_THAT(refusal({"rig.coils.tesla_per_ampere=[[1]]"}), HasSubstr("tesla_per_ampere"));
}

}  // namespace
}  // namespace gastronaut
