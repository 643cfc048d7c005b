// Whole logs through the whole evaluation: written here, scored, and the figures compared with what
// was put in.
#include "evaluate/log_evaluation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <gastronaut/capsule_state_t.hpp>
#include <gastronaut/depth_image_t.hpp>
#include <gastronaut/hall_array_t.hpp>
#include <gastronaut/magnetic_pose_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <gastronaut/rigid_transform_t.hpp>
#include <nlohmann/json.hpp>

#include "bus/log_file.hpp"
#include "configuration/rig_configuration.hpp"
#include "evaluate/evaluate_process.hpp"
#include "evaluate/report.hpp"
#include "process/channels.hpp"
#include "random_numbers.hpp"
#include "trajectory/trajectory_file.hpp"

namespace gastronaut::evaluation {
namespace {

using testing::HasSubstr;

constexpr std::int64_t kStart = 1700000000000000;  // microseconds
constexpr std::int64_t kMagneticPeriod = 10000;
constexpr std::int64_t kCameraPeriod = 50000;
constexpr int kReadings = 400;
constexpr double kPositionSigma = 0.0006;  // metres, per axis
constexpr double kAxisSigma = 0.01;        // radians, per rotation
constexpr int kFirstLost = 100;            // readings without a fix
constexpr int kFirstFoundAgain = 200;
constexpr double kDepthError = 0.0015;  // metres
constexpr std::int64_t kInitialised = kStart + 200000;
constexpr std::int64_t kBlindNoticed = kStart + 1100000;
constexpr std::int64_t kBlindRecovered = kStart + 2200000;

SE3 true_pose(std::int64_t utime) {
  const double t = static_cast<double>(utime - kStart) * 1e-6;
  return {so3_exp({0.2 * std::sin(t), 0.1 * t, 0}),
          {0.02 * std::cos(t), 0.015 * std::sin(2 * t), 0.004 * t}};
}

RigConfiguration configuration() {
  RigConfiguration result;
  result.name = "synthetic";
  result.camera_T_magnet.translation = {0.0005, -0.001, -0.012};
  return result;
}

struct LogContents {
  bool with_configuration = true;
  bool with_truth = true;
  bool with_poses = true;
  bool with_depth = true;
  bool with_states = false;
};

depth_image_t depth_picture(std::int64_t utime, double metres) {
  depth_image_t message{};
  message.utime = utime;
  message.width = 32;
  message.height = 24;
  message.fx = message.fy = 20;
  message.cx = 15.5;
  message.cy = 11.5;
  message.metres_per_count = 1e-5;
  message.encoding = depth_image_t::ENCODING_RAW;
  const auto count = static_cast<std::uint16_t>(std::lround(metres / message.metres_per_count));
  for (int i = 0; i < message.width * message.height; ++i) {
    message.data.push_back(static_cast<std::uint8_t>(count & 0xFF));
    message.data.push_back(static_cast<std::uint8_t>(count >> 8));
  }
  message.size = static_cast<std::int32_t>(message.data.size());
  return message;
}

magnetic_pose_t magnetic_pose(std::int64_t utime, int number, Draws& draws) {
  const SE3 truth = true_pose(utime) * configuration().camera_T_magnet.transform();
  const Eigen::Vector3d axis = truth.rotation * Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d position = truth.translation + draws.vector(kPositionSigma);
  const Eigen::Vector3d turn = draws.vector(kAxisSigma);
  const Eigen::Vector3d noisy_axis = so3_exp(perpendicular_basis(axis) * turn.head<2>()) * axis;
  const bool lost = number >= kFirstLost && number < kFirstFoundAgain;
  magnetic_pose_t message{};
  message.utime = utime;
  message.seq = number;
  message.status = lost ? magnetic_pose_t::STATUS_TOO_FAR : magnetic_pose_t::STATUS_OK;
  for (int k = 0; k < 3; ++k) {
    message.position[k] = position[k] + (lost ? 1 : 0);
    message.axis[k] = noisy_axis[k];
    message.covariance[k][k] = kPositionSigma * kPositionSigma;
    message.background[k] = 1e-5 * (k + 1);
  }
  message.covariance[3][3] = message.covariance[4][4] = kAxisSigma * kAxisSigma;
  message.moment = configuration().magnet.moment;
  message.chi2_per_dof = 1 + 0.1 * draws.normal();
  return message;
}

// Fused without error; vision is held for failed from 1.1 s to 2.2 s.
capsule_state_t capsule_state(std::int64_t utime) {
  const SE3 truth = true_pose(utime);
  const bool initialising = utime < kInitialised;
  const bool blind = utime >= kBlindNoticed && utime < kBlindRecovered;
  capsule_state_t message{};
  message.utime = utime;
  message.status = initialising ? capsule_state_t::STATUS_INITIALISING
                   : blind      ? capsule_state_t::STATUS_DEGRADED
                                : capsule_state_t::STATUS_NOMINAL;
  Eigen::Map<Eigen::Vector3d>(message.position) = truth.translation;
  message.orientation[0] = truth.rotation.w();
  Eigen::Map<Eigen::Vector3d>(message.orientation + 1) = truth.rotation.vec();
  for (int k = 0; k < 6; ++k) message.covariance[k][k] = 1e-8;
  message.depth_scale = 1;
  message.num_sensors = 2;
  message.sensors.resize(2);
  message.sensors[0] = {"magnetic", initialising ? 0.0 : 0.99, 0.95, true, ""};
  message.sensors[1] = {"visual", blind ? 0.02 : 0.98, blind ? 0.1 : 0.9, !blind,
                        blind ? "low, texture" : ""};
  return message;
}

void write_log(const std::string& path, const LogContents& contents) {
  LogWriter log(path);
  Draws draws(41);
  if (contents.with_configuration) {
    rig_config_t message{};
    message.utime = kStart;
    message.name = "synthetic";
    message.yaml = write_configuration(configuration());
    message.code_version = "1.2.3+test";
    log.write(channel::kRigConfig, message);
  }
  for (int i = 0; i < kReadings; ++i) {
    const std::int64_t utime = kStart + i * kMagneticPeriod;
    if (utime % kCameraPeriod == 0) {
      if (contents.with_truth) {
        const SE3 truth = true_pose(utime);
        rigid_transform_t message{};
        message.utime = utime;
        Eigen::Map<Eigen::Vector3d>(message.trans) = truth.translation;
        message.quat[0] = truth.rotation.w();
        Eigen::Map<Eigen::Vector3d>(message.quat + 1) = truth.rotation.vec();
        log.write(channel::kGroundTruthPose, message);
      }
      if (contents.with_depth) {
        log.write(channel::kDepth, depth_picture(utime, 0.04 + kDepthError));
        log.write(channel::kGroundTruthDepth, depth_picture(utime, 0.04));
      }
    }
    hall_array_t reading{};
    reading.utime = utime;
    reading.seq = i;
    reading.num_sensors = 64;
    reading.num_axes = 3;
    reading.field.assign(64, std::vector<float>(3, 1e-5F));
    reading.status.assign(64, hall_array_t::STATUS_OK);
    log.write(channel::kHallArray, reading);
    if (contents.with_poses) {
      log.write(channel::kMagneticPose, magnetic_pose(utime, i, draws));
    }
    if (contents.with_states) log.write(channel::kCapsuleState, capsule_state(utime));
  }
  log.close();
}

class LogEvaluationTest : public testing::Test {
 protected:
  LogEvaluationTest() {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }

  nlohmann::json evaluate(const LogContents& contents) {
    write_log(log_, contents);
    return evaluate_existing();
  }

  nlohmann::json evaluate_existing() {
    evaluate_log(log_, folder_);
    std::ifstream file(folder_ + "/metrics.json");
    return nlohmann::json::parse(file);
  }

  static std::string notes(const nlohmann::json& metrics) {
    std::string text;
    for (const auto& [key, value] : metrics.items()) {
      if (key.starts_with("note.")) text += value.get<std::string>() + "\n";
    }
    return text;
  }

  std::string folder_ = testing::TempDir() + "/evaluate_" +
                        testing::UnitTest::GetInstance()->current_test_info()->name();
  std::string log_ = folder_ + "/derived.lcmlog";
};

TEST_F(LogEvaluationTest, FindsTheErrorsThatWerePutIn) {
  const nlohmann::json metrics = evaluate({});
  EXPECT_EQ(metrics["run.configuration"], "synthetic");
  EXPECT_EQ(metrics["run.code_version"], "1.2.3+test");
  EXPECT_EQ(metrics["run.damage"], "");
  EXPECT_EQ(metrics["messages.MAGNETIC_POSE.count"], kReadings);
  EXPECT_EQ(metrics["MAGNETIC_POSE.count"], kReadings);
  const int lost = kFirstFoundAgain - kFirstLost;
  EXPECT_EQ(metrics["MAGNETIC_POSE.usable"], kReadings - lost);
  EXPECT_EQ(metrics["MAGNETIC_POSE.status.TOO_FAR.count"], lost);

  const double count = metrics["MAGNETIC_POSE.with_truth"].get<double>();
  // Fixes after the last truth have none: four of five between two pictures.
  EXPECT_EQ(count, kReadings - lost - 4);
  // Three standard deviations of an RMS of that many numbers.
  const double spread = 3 / std::sqrt(2 * 3 * count);
  const double position = std::sqrt(3.0) * kPositionSigma;
  EXPECT_NEAR(metrics["MAGNETIC_POSE.ate.none.rmse"], position, spread * position);
  const double axis_degrees = std::sqrt(2.0) * kAxisSigma * 180 / M_PI;
  const double axis_spread = 3 / std::sqrt(2 * 2 * count);
  EXPECT_NEAR(metrics["MAGNETIC_POSE.axis_error_deg.rmse"], axis_degrees,
              axis_spread * axis_degrees);
  EXPECT_NEAR(metrics["MAGNETIC_POSE.error.x.std"], kPositionSigma,
              std::sqrt(3.0) * spread * kPositionSigma);
  EXPECT_GT(metrics["MAGNETIC_POSE.nees.mean"], metrics["MAGNETIC_POSE.nees.band_low"]);
  EXPECT_LT(metrics["MAGNETIC_POSE.nees.mean"], metrics["MAGNETIC_POSE.nees.band_high"]);
  EXPECT_EQ(metrics["MAGNETIC_POSE.nees.degrees_of_freedom"], 5);
  // A lost fix is a metre off, which the usable ones must not see.
  EXPECT_GT(metrics["MAGNETIC_POSE.status.TOO_FAR.position.min"], 0.5);
  EXPECT_LT(metrics["MAGNETIC_POSE.ate.none.max"], 0.1);
  // Truth spans 3.95 s; 101 intervals lie between the fixes around the hole, 1.5 of them covered.
  EXPECT_NEAR(metrics["MAGNETIC_POSE.availability"], 1 - 0.01 * (101 - 1.5) / 3.95, 1e-6);
  EXPECT_NEAR(metrics["MAGNETIC_POSE.background_y.median"], 2e-5, 1e-12);

  constexpr double kHalfCount = 5e-6;  // metres, of the depth pictures
  EXPECT_EQ(metrics["DEPTH.count"], kReadings * kMagneticPeriod / kCameraPeriod);
  EXPECT_NEAR(metrics["DEPTH.mean_abs"], kDepthError, kHalfCount);
  EXPECT_NEAR(metrics["DEPTH.mean_abs_scaled"], 0, kHalfCount);
  EXPECT_EQ(metrics["DEPTH.coverage"], 1);
  EXPECT_NEAR(metrics["DEPTH.bias"], kDepthError, kHalfCount);
  EXPECT_EQ(metrics["DEPTH.30_to_45mm.count"], 80 * 32 * 24);
  EXPECT_NEAR(metrics["DEPTH.30_to_45mm.mean_abs"], kDepthError, kHalfCount);
  EXPECT_EQ(metrics["DEPTH.15_to_30mm.count"], 0);
  EXPECT_FALSE(metrics.contains("DEPTH.normalised_error"));  // DEPTH says no sigma
  EXPECT_GT(metrics["MAGNETIC_POSE.cramer_rao.position_rms"], 0);
  EXPECT_NEAR(metrics["MAGNETIC_POSE.cramer_rao.count"], kReadings - 4, 0);
  // The array is 85 mm above the rig's origin, around which the capsule goes.
  EXPECT_GT(metrics["MAGNETIC_POSE.sensor_distance.min"], 0.05);
  EXPECT_EQ(metrics["MAGNETIC_POSE.within_5cm.count"], 0);
  EXPECT_THAT(notes(metrics), HasSubstr("timing.json"));
}

TEST_F(LogEvaluationTest, JudgesWhatTheFusionBelievesOfItsSensors) {
  write_log(log_, {.with_states = true});
  evaluate_log(log_, folder_, {}, "", {{"visual", 1, 2}});
  std::ifstream file(folder_ + "/metrics.json");
  const auto metrics = nlohmann::json::parse(file);
  constexpr double kRounding = 1e-9;
  EXPECT_NEAR(metrics["failure.visual.1.detection_delay"], 0.1, kRounding);
  EXPECT_NEAR(metrics["failure.visual.1.recovery_delay"], 0.2, kRounding);
  EXPECT_NEAR(metrics["failure.visual.1.missed_share"], 0.1, kRounding);
  EXPECT_EQ(metrics["failure.visual.false_alarms.count"], 0);
  // What it says of the magnet before it has a state is no alarm.
  EXPECT_EQ(metrics["failure.magnetic.false_alarms.count"], 0);
  EXPECT_EQ(metrics["failure.threshold"], configuration().sensor_fusion.failure_threshold);
  // Truth is interpolated over 50 ms, along a curve with accelerations of 0.06 m/s^2.
  constexpr double kInterpolation = 0.06 * 0.05 * 0.05 / 8;
  EXPECT_NEAR(metrics["comparison.50mm.CAPSULE_STATE.none"], 0, kInterpolation);
  EXPECT_GT(metrics["comparison.50mm.CAPSULE_STATE.count"], 0);

  std::ifstream series(folder_ + "/sensor_health.csv");
  std::vector<std::string> lines;
  for (std::string line; std::getline(series, line);) lines.push_back(line);
  constexpr std::size_t kStates = kReadings - (kInitialised - kStart) / kMagneticPeriod;
  ASSERT_EQ(lines.size(), 1 + 2 * kStates);
  EXPECT_EQ(lines[0], "utime,p_nominal,alpha,used,sensor,cause");
  EXPECT_EQ(lines[1], "1700000000200000,0.99,0.95,1,magnetic,");
  EXPECT_THAT(lines, testing::Contains("1700000001500000,0.02,0.1,0,visual,low_ texture"));
}

TEST_F(LogEvaluationTest, WithoutTrueFailuresSaysThatAlarmsCountAsFalse) {
  const nlohmann::json metrics = evaluate({.with_states = true});
  EXPECT_EQ(metrics["failure.visual.false_alarms.count"], 1);
  EXPECT_THAT(notes(metrics), HasSubstr("no --failure was given"));
  EXPECT_THAT(notes(evaluate({})), testing::Not(HasSubstr("--failure")));
  evaluate_log(log_, folder_, {}, "", {{"visual", 1, 2}});
  std::ifstream file(folder_ + "/metrics.json");
  EXPECT_THAT(notes(nlohmann::json::parse(file)), HasSubstr("no CAPSULE_STATE"));
}

TEST_F(LogEvaluationTest, ExportsTrajectoriesThatScoreTheSame) {
  const nlohmann::json metrics = evaluate({});
  const MatchedTrajectory matched =
      match(read_trajectory(folder_ + "/MAGNETIC_POSE.tum", TrajectoryFormat::kTum),
            read_trajectory(folder_ + "/GROUND_TRUTH_MAGNET.tum", TrajectoryFormat::kTum), 1);
  // The truth has samples at every fifth reading.
  ASSERT_GT(matched.count_matched(), 50U);
  const double rmse = statistics(absolute_errors(matched, Alignment{})).rmse;
  const double expected = metrics["MAGNETIC_POSE.ate.none.rmse"];
  EXPECT_NEAR(rmse, expected, 0.3 * expected);  // 60 of 300 random errors
  EXPECT_EQ(read_trajectory(folder_ + "/GROUND_TRUTH_POSE.tum", TrajectoryFormat::kTum).size(),
            80U);
}

TEST_F(LogEvaluationTest, ReadsTheTimesThatReplayMeasured) {
  std::ofstream(log_ + ".timing.json")
      << R"({"wall_seconds":2,"cpu_seconds":3,"peak_resident_bytes":5000000,"threads":2,)"
      << R"("processes":{"magnetic_localizer":)"
      << R"({"events":400,"ms_median":0.02,"ms_p99":0.05,"ms_max":1.5}}})";
  const nlohmann::json metrics = evaluate({});
  EXPECT_EQ(metrics["magnetic_localizer.ms_per_event.median"], 0.02);
  EXPECT_EQ(metrics["magnetic_localizer.ms_per_event.p99"], 0.05);
  EXPECT_EQ(metrics["magnetic_localizer.ms_per_event.max"], 1.5);
  EXPECT_EQ(metrics["replay.wall_seconds"], 2);
  EXPECT_EQ(notes(metrics), "");
}

TEST_F(LogEvaluationTest, SaysWhatIsMissingAndScoresTheRest) {
  EXPECT_THAT(notes(evaluate({.with_truth = false})), HasSubstr("no GROUND_TRUTH_POSE"));
  EXPECT_THAT(notes(evaluate({.with_poses = false})), HasSubstr("no pose channel"));
  const nlohmann::json without_configuration = evaluate({.with_configuration = false});
  EXPECT_THAT(notes(without_configuration), HasSubstr("no RIG_CONFIG"));
  EXPECT_FALSE(without_configuration.contains("MAGNETIC_POSE.ate.none.rmse"));
  EXPECT_TRUE(without_configuration.contains("DEPTH.mean_abs"));
}

TEST_F(LogEvaluationTest, UsesADamagedLogUpToTheDamage) {
  write_log(log_, {});
  std::filesystem::resize_file(log_, std::filesystem::file_size(log_) / 2 + 5);
  const nlohmann::json metrics = evaluate_existing();
  EXPECT_THAT(metrics["run.damage"].get<std::string>(), HasSubstr("offset"));
  EXPECT_THAT(notes(metrics), HasSubstr("everything before it was used"));
  EXPECT_GT(metrics["MAGNETIC_POSE.with_truth"], 50);
  EXPECT_LT(metrics["MAGNETIC_POSE.ate.none.max"], 0.1);
}

TEST_F(LogEvaluationTest, CountsMessagesThatAreNoMessages) {
  {
    write_log(folder_ + "/good.lcmlog", {});
    LogReader good(folder_ + "/good.lcmlog");
    LogWriter log(log_);
    const std::vector<std::uint8_t> nonsense(40, 0xA5);
    log.write(channel::kMagneticPose, Bytes(nonsense), kStart);
    log.write(channel::kGroundTruthDepth, Bytes(), kStart);
    while (const auto event = good.next()) {
      log.write(event->channel, event->payload, event->log_utime);
    }
    log.close();
  }
  const nlohmann::json metrics = evaluate_existing();
  EXPECT_EQ(metrics["messages.MAGNETIC_POSE.corrupt"], 1);
  EXPECT_EQ(metrics["messages.GROUND_TRUTH_DEPTH.corrupt"], 1);
  EXPECT_EQ(metrics["MAGNETIC_POSE.count"], kReadings);
  EXPECT_THAT(notes(metrics), HasSubstr("1 of 401 messages of MAGNETIC_POSE"));
}

TEST_F(LogEvaluationTest, RefusesALogWithoutMessages) {
  std::ofstream{log_};
  EXPECT_THROW(evaluate_log(log_, folder_), std::runtime_error);
  EXPECT_THROW(evaluate_log(folder_ + "/absent.lcmlog", folder_), std::runtime_error);
}

TEST_F(LogEvaluationTest, TheSameLogGivesTheSameBytes) {
  evaluate({});
  const auto contents = [this](const char* name) {
    std::ifstream file(folder_ + "/" + name);
    return std::string(std::istreambuf_iterator<char>(file), {});
  };
  const std::string metrics = contents("metrics.json");
  const std::string series = contents("MAGNETIC_POSE.csv");
  evaluate_existing();
  EXPECT_EQ(contents("metrics.json"), metrics);
  EXPECT_EQ(contents("MAGNETIC_POSE.csv"), series);
  EXPECT_FALSE(series.empty());
}

class EvaluateProgramTest : public LogEvaluationTest {
 protected:
  // Exit status of the program.
  static int run(const std::string& arguments) {
    const int status = std::system(
        (GASTRONAUT_BINARY_DIR "/bin/evaluate " + arguments + " >/dev/null 2>&1").c_str());
    return WEXITSTATUS(status);
  }
};

TEST_F(EvaluateProgramTest, DrawsOnePageWithItsPlotsInside) {
  write_log(log_, {.with_states = true});
  ASSERT_EQ(run("--frames 0,79 --failure visual:1-2 '" + log_ + "' --out '" + folder_ + "/report'"),
            0);
  for (const char* plot : {"trajectory", "errors", "histogram", "consistency", "relative", "fit"}) {
    EXPECT_TRUE(std::filesystem::exists(folder_ + "/report/MAGNETIC_POSE_" + plot + ".png"))
        << plot;
  }
  for (const char* plot : {"DEPTH_errors", "DEPTH_by_distance", "frame_000000", "frame_000079",
                           "failures", "comparison"}) {
    EXPECT_TRUE(std::filesystem::exists(folder_ + "/report/" + plot + ".png")) << plot;
  }
  std::ifstream file(folder_ + "/report/index.html");
  const std::string page(std::istreambuf_iterator<char>(file), {});
  EXPECT_THAT(page, HasSubstr("synthetic"));
  EXPECT_THAT(page, HasSubstr("Magnetic position error, RMS"));
  EXPECT_THAT(page, HasSubstr("Sensor failures over time"));
  EXPECT_THAT(page, HasSubstr("1 – 2 s"));
  EXPECT_THAT(page, HasSubstr("data:image/png;base64,"));
  EXPECT_THAT(page, testing::Not(HasSubstr("src=\"http")));
}

TEST_F(EvaluateProgramTest, ExitStatusTellsWrongUseFromFailure) {
  write_log(log_, {});
  EXPECT_EQ(run("--version"), 0);
  EXPECT_EQ(run(""), 2);
  EXPECT_EQ(run("'" + log_ + "'"), 2);
  EXPECT_EQ(run("'" + log_ + "' --out '" + folder_ + "/report' --frames first"), 2);
  EXPECT_EQ(run("'" + log_ + "' --out '" + folder_ + "/report' --failure visual:2"), 2);
  EXPECT_EQ(run("/nonexistent.lcmlog --out '" + folder_ + "/report'"), 2);
  EXPECT_EQ(run("trajectories '" + log_ + "'"), 2);
  std::ofstream(folder_ + "/empty.lcmlog");
  EXPECT_EQ(run("'" + folder_ + "/empty.lcmlog' --out '" + folder_ + "/report'"), 1);
  EXPECT_EQ(run("'" + log_ + "' --out '" + log_ + "'"), 1);
  evaluate_log(log_, folder_);
  const std::string trajectory = "'" + folder_ + "/GROUND_TRUTH_POSE.tum'";
  EXPECT_EQ(run("trajectories " + trajectory + " " + trajectory), 0);
  EXPECT_EQ(run("trajectories " + trajectory + " " + trajectory + " --rpe-delta 3furlongs"), 2);
  EXPECT_EQ(run("trajectories " + trajectory + " '" + folder_ + "/metrics.json'"), 1);
}

}  // namespace
}  // namespace gastronaut::evaluation
