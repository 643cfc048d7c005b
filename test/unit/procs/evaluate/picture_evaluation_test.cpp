// Logs with pictures, written here, through the whole evaluation.
#include "evaluate/picture_evaluation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <gastronaut/depth_image_t.hpp>
#include <gastronaut/image_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <gastronaut/rigid_transform_t.hpp>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "bus/log_file.hpp"
#include "configuration/rig_configuration.hpp"
#include "evaluate/log_evaluation.hpp"
#include "process/channels.hpp"

namespace gastronaut::evaluation {
namespace {

using testing::HasSubstr;
using testing::Not;

constexpr std::int64_t kStart = 1700000000000000;  // microseconds
constexpr std::int64_t kPeriod = 100000;
constexpr int kFrames = 15;
constexpr int kWidth = 64;
constexpr int kHeight = 48;
constexpr int kBinning = 2;          // ALBEDO's pixels along one of DEPTH's
constexpr double kTrueDepth = 0.04;  // metres
constexpr double kDepthError = 0.002;
// The lamp flickers by this share of its mean, every other frame up or down; ALBEDO knows it.
constexpr double kFlicker = 0.2;
// JPEG's loss at quality 95, and levels rounded to half of one in 100.
constexpr double kLevelRounding = 0.01;

RigConfiguration configuration() {
  RigConfiguration result;
  result.camera.width = kWidth;
  result.camera.height = kHeight;
  result.camera.fx = result.camera.fy = 40;
  result.camera.cx = 31.5;
  result.camera.cy = 23.5;
  return result;
}

double level(int u, int v) { return 120 + 40 * std::sin(0.2 * u) * std::cos(0.2 * v); }

depth_image_t depth_message(std::int64_t utime, double metres) {
  depth_image_t message{};
  message.utime = utime;
  message.width = kWidth / kBinning;
  message.height = kHeight / kBinning;
  message.fx = message.fy = 40.0 / kBinning;
  message.cx = (31.5 - 0.5) / kBinning;
  message.cy = (23.5 - 0.5) / kBinning;
  message.metres_per_count = 1e-5;
  message.relative_std = kDepthError / (kTrueDepth + kDepthError);
  const auto count = static_cast<std::uint16_t>(std::lround(metres / message.metres_per_count));
  for (int i = 0; i < message.width * message.height; ++i) {
    message.data.push_back(static_cast<std::uint8_t>(count & 0xFF));
    message.data.push_back(static_cast<std::uint8_t>(count >> 8));
  }
  message.size = static_cast<std::int32_t>(message.data.size());
  return message;
}

image_t gray_message(std::int64_t utime, int width, int height, double factor) {
  image_t message{};
  message.utime = utime;
  message.width = message.row_stride = width;
  message.height = height;
  message.pixelformat = image_t::PIXEL_FORMAT_GRAY;
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      message.data.push_back(static_cast<std::uint8_t>(std::lround(factor * level(u, v))));
    }
  }
  message.size = static_cast<std::int32_t>(message.data.size());
  return message;
}

image_t jpeg_message(const image_t& gray) {
  image_t message = gray;
  message.row_stride = 0;
  message.pixelformat = image_t::PIXEL_FORMAT_MJPEG;
  cv::imencode(".jpg",
               cv::Mat(gray.height, gray.width, CV_8U, const_cast<std::uint8_t*>(gray.data.data())),
               message.data);
  message.size = static_cast<std::int32_t>(message.data.size());
  return message;
}

struct LogContents {
  bool with_camera = true;
  bool with_truth = true;
  bool with_misfits = false;
};

constexpr int kTruncated = 2;  // numbers of the misfits
constexpr int kOtherSize = 4;
constexpr int kFailed = 6;
constexpr int kOddAlbedo = 8;

void write_log(const std::string& path, const LogContents& contents) {
  LogWriter log(path);
  rig_config_t configured{};
  configured.utime = kStart;
  configured.yaml = write_configuration(configuration());
  log.write(channel::kRigConfig, configured);
  for (int i = 0; i < kFrames; ++i) {
    const std::int64_t utime = kStart + i * kPeriod;
    const auto misfit = [&](int number) { return contents.with_misfits && i == number; };
    if (contents.with_truth) {
      rigid_transform_t pose{};
      pose.utime = utime;
      pose.quat[0] = 1;
      log.write(channel::kGroundTruthPose, pose);
      log.write(channel::kGroundTruthDepth, depth_message(utime, kTrueDepth));
    }
    if (contents.with_camera) {
      const double lamp = i % 2 == 0 ? 1 + kFlicker : 1 - kFlicker;
      const int width = misfit(kOtherSize) ? 1 : kWidth;
      image_t camera = jpeg_message(gray_message(utime, width, kHeight, lamp));
      if (misfit(kTruncated)) {
        camera.data.resize(camera.data.size() / 2);
        camera.size = static_cast<std::int32_t>(camera.data.size());
      }
      log.write(channel::kCamera, camera);
    }
    const bool failed = misfit(kFailed);
    log.write(channel::kDepth, depth_message(utime, failed ? 0 : kTrueDepth + kDepthError));
    image_t albedo =
        gray_message(utime, misfit(kOddAlbedo) ? kWidth + 1 : kWidth, kHeight, failed ? 0 : 1);
    if (failed) {
      const std::string why = "black";
      image_metadata_t metadata;
      metadata.key = "failure";
      metadata.value.assign(why.begin(), why.end());
      metadata.n = static_cast<std::int32_t>(why.size());
      albedo.metadata.push_back(metadata);
      albedo.nmetadata = 1;
    }
    log.write(channel::kAlbedo, albedo);
    log.write(channel::kVessels, gray_message(utime, kWidth, kHeight, 0.5));
  }
  log.close();
}

class PictureEvaluationTest : public testing::Test {
 protected:
  PictureEvaluationTest() {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }

  nlohmann::json evaluate(const LogContents& contents, const std::vector<std::size_t>& frames) {
    write_log(log_, contents);
    evaluate_log(log_, folder_, frames);
    return read("metrics.json");
  }

  nlohmann::json read(const std::string& name) const {
    std::ifstream file(folder_ + "/" + name);
    return nlohmann::json::parse(file);
  }

  std::string folder_ = testing::TempDir() + "/evaluate_" +
                        testing::UnitTest::GetInstance()->current_test_info()->name();
  std::string log_ = folder_ + "/derived.lcmlog";
};

TEST_F(PictureEvaluationTest, TellsAlbedoThatStaysFromLuminanceThatDoesNot) {
  const nlohmann::json metrics = evaluate({}, {0});
  EXPECT_NEAR(metrics["albedo.spread"], 0, kLevelRounding);
  // Of values 1 - f and 1 + f, one of the odd number more: f to half a percent.
  EXPECT_NEAR(metrics["luminance.spread"], kFlicker, kLevelRounding);
  EXPECT_NEAR(metrics["luminance.contrast"], metrics["albedo.contrast"], kLevelRounding);
  EXPECT_NEAR(
      metrics["luminance.spread_over_contrast"].get<double>(),
      metrics["luminance.spread"].get<double>() / metrics["luminance.contrast"].get<double>(),
      1e-12);  // doubles as text
  // Equalising takes away most of a change that is the same everywhere.
  EXPECT_LT(metrics["clahe.spread"], 0.5 * kFlicker);
  EXPECT_EQ(metrics["constancy.distance_ratio"], 1);
  constexpr double kCounts = 5e-3;  // half a count of 10 micrometres in 2 mm
  EXPECT_NEAR(metrics["DEPTH.normalised_error"], 1, kCounts);
}

TEST_F(PictureEvaluationTest, WritesWhatThereIsOfEachFrame) {
  evaluate({.with_camera = true, .with_truth = false}, {3, 7});
  const nlohmann::json frames = read("frames/frames.json");
  ASSERT_EQ(frames.size(), 2U);
  EXPECT_EQ(frames[1]["number"], 7);
  EXPECT_NEAR(frames[1]["seconds"], 0.7, 1e-9);  // whole microseconds
  EXPECT_TRUE(frames[1]["files"].contains("input"));
  EXPECT_FALSE(frames[1]["files"].contains("truth"));
  const cv::Mat counts = cv::imread(folder_ + "/frames/7_depth.png", cv::IMREAD_UNCHANGED);
  ASSERT_EQ(counts.type(), CV_16UC1);
  EXPECT_NEAR(counts.at<std::uint16_t>(5, 5) * frames[1]["metres_per_count"].get<double>(),
              kTrueDepth + kDepthError, 1e-6);  // 16 bits and single precision of 42 mm
}

TEST_F(PictureEvaluationTest, WithoutCameraTheAlbedoIsStillMeasured) {
  const nlohmann::json metrics = evaluate({.with_camera = false}, {0});
  EXPECT_NEAR(metrics["albedo.spread"], 0, kLevelRounding);
  EXPECT_FALSE(metrics.contains("luminance.spread"));
  EXPECT_THAT(metrics.dump(), HasSubstr("no CAMERA in the log"));
  EXPECT_FALSE(read("frames/frames.json")[0]["files"].contains("input"));
}

TEST_F(PictureEvaluationTest, NotesPicturesThatCannotBeUsedAndGoesOn) {
  const nlohmann::json metrics =
      evaluate({.with_misfits = true}, {kTruncated, kOtherSize, kFailed, kOddAlbedo});
  const std::string text = metrics.dump();
  EXPECT_THAT(text, HasSubstr("CAMERA: the data are damaged"));
  EXPECT_THAT(text, HasSubstr("CAMERA: the picture has another size"));
  EXPECT_THAT(text, HasSubstr("ALBEDO: its size is no whole multiple"));
  EXPECT_THAT(text, HasSubstr("1 of 15 pictures could not be used by depth_estimator: black"));
  EXPECT_NEAR(metrics["albedo.spread"], 0, kLevelRounding);
  EXPECT_NEAR(metrics["DEPTH.coverage"], (kFrames - 1.0) / kFrames, 1e-12);
  const nlohmann::json frames = read("frames/frames.json");
  ASSERT_EQ(frames.size(), 4U);
  EXPECT_FALSE(frames[0]["files"].contains("input"));
  EXPECT_FALSE(frames[1]["files"].contains("input"));
  EXPECT_EQ(frames[2]["metadata"]["failure"], "black");
}

TEST_F(PictureEvaluationTest, DrawsFramesWithAndWithoutTheirPictures) {
  const auto draw = [this](const LogContents& contents, const std::string& name) {
    write_log(log_, contents);
    const std::string report = folder_ + "/" + name;
    const int status = std::system((GASTRONAUT_BINARY_DIR "/bin/evaluate '" + log_ + "' --out '" +
                                    report + "' --frames 4,6,8 >/dev/null 2>&1")
                                       .c_str());
    EXPECT_EQ(WEXITSTATUS(status), 0) << name;
    for (const char* frame : {"4", "6", "8"}) {
      EXPECT_TRUE(std::filesystem::exists(report + "/frame_00000" + frame + ".png")) << name;
    }
    std::ifstream page(report + "/index.html");
    return std::string(std::istreambuf_iterator<char>(page), {});
  };
  EXPECT_THAT(draw({.with_misfits = true}, "misfits"), HasSubstr("equalised contrast"));
  EXPECT_THAT(draw({.with_camera = false, .with_truth = false}, "bare"),
              Not(HasSubstr("equalised contrast")));
}

}  // namespace
}  // namespace gastronaut::evaluation
