#include "depth_estimator/depth_estimator_process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zstd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "bus/memory_bus.hpp"
#include "gastronaut/depth_image_t.hpp"
#include "gastronaut/image_t.hpp"
#include "process/channels.hpp"
#include "unit/procs/depth_estimator/jpeg_encoder.hpp"
#include "unit/procs/depth_estimator/lit_surface.hpp"

namespace gastronaut {
namespace {

using perception::Surface;
using perception::to_jpeg;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

// Smoothness, 8-bit levels and JPEG: half of what the albedo's usual variation costs.
constexpr double kPictureError = 0.02;
constexpr double kGrain = 0.15;
constexpr double kWallDistance = 0.035;  // metres

struct Outputs {
  depth_image_t depth;
  image_t albedo;
  image_t vessels;
  std::vector<std::uint16_t> counts;

  // Means over some pixels around: the wall's grain is not what is asked for.
  double depth_at(int u, int v) const {
    return mean(u, v,
                [&](int column, int row) {
                  return counts[static_cast<std::size_t>(row * depth.width + column)];
                }) *
           depth.metres_per_count;
  }
  double albedo_at(int u, int v) const {
    return mean(u, v, [&](int column, int row) {
      return albedo.data[static_cast<std::size_t>(row * albedo.width + column)];
    });
  }
  template <class Value>
  static double mean(int u, int v, const Value& value) {
    constexpr int kReach = 8;
    double sum = 0;
    for (int row = v - kReach; row <= v + kReach; ++row) {
      for (int column = u - kReach; column <= u + kReach; ++column) sum += value(column, row);
    }
    return sum / ((2 * kReach + 1) * (2 * kReach + 1));
  }
  std::string metadata(const std::string& key) const {
    for (const image_metadata_t& entry : albedo.metadata) {
      if (entry.key == key) return {entry.value.begin(), entry.value.end()};
    }
    return "";
  }
};

class DepthEstimatorProcessTest : public ::testing::Test {
 protected:
  DepthEstimatorProcessTest()
      : network_([this](const std::string& channel, Bytes payload, std::int64_t) {
          ++published_[channel];
          if (channel == channel::kDepth) decode_message(payload, outputs_.depth);
          if (channel == channel::kAlbedo) decode_message(payload, outputs_.albedo);
          if (channel == channel::kVessels) decode_message(payload, outputs_.vessels);
        }) {
    CameraConfiguration& camera = rig_.camera;
    camera.width = 160;
    camera.height = 120;
    camera.fx = camera.fy = 83.2;
    camera.cx = 80.4;
    camera.cy = 58.4;
  }

  void start() {
    bus_ = &network_.connect();
    process_ = std::make_unique<DepthEstimatorProcess>(*bus_, rig_);
  }

  // The wall as the camera's equation in rig_configuration.hpp has it.
  std::vector<std::uint8_t> photograph(const Surface& surface, double gain = 1) {
    const CameraConfiguration& camera = rig_.camera;
    std::vector<std::uint8_t> rgb;
    for (int v = 0; v < camera.height; ++v) {
      for (int u = 0; u < camera.width; ++u) {
        const Eigen::Vector3d ray((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1);
        const double vignetting = std::pow(1 / ray.norm(), camera.vignetting_cos_power);
        // Tissue has grain; a picture without any is taken for a veiled one.
        const double grain = 1 + grain_ * std::sin(1.1 * u + 0.4 * v) * std::sin(0.9 * v - 0.3 * u);
        for (const double albedo : rig_.depth_estimator.albedo) {
          const double light = gain * camera.exposure_gain * camera.led_intensity * vignetting *
                               albedo * grain * perception::light_on(surface(ray), rig_.lights);
          const double level = 255 * std::pow(std::min(light, 1.0), 1 / camera.gamma);
          rgb.push_back(static_cast<std::uint8_t>(std::lround(level)));
        }
      }
    }
    return rgb;
  }

  image_t camera_message(std::vector<std::uint8_t> jpeg) {
    image_t message;
    message.utime = utime_ += 50'000;
    message.width = rig_.camera.width;
    message.height = rig_.camera.height;
    message.row_stride = 0;
    message.pixelformat = image_t::PIXEL_FORMAT_MJPEG;
    message.data = std::move(jpeg);
    message.size = static_cast<std::int32_t>(message.data.size());
    message.nmetadata = 0;
    return message;
  }

  image_t picture_of(const Surface& surface, double gain = 1) {
    return camera_message(
        to_jpeg(photograph(surface, gain), rig_.camera.width, rig_.camera.height));
  }

  static void tell(image_t& picture, const std::string& key, const std::string& value) {
    image_metadata_t entry;
    entry.key = key;
    entry.value.assign(value.begin(), value.end());
    entry.n = static_cast<std::int32_t>(value.size());
    picture.metadata.push_back(entry);
    picture.nmetadata = static_cast<std::int32_t>(picture.metadata.size());
  }

  const Outputs& see(const image_t& picture) {
    network_.inject(channel::kCamera, encode_message(picture));
    network_.run_until_idle();
    EXPECT_EQ(outputs_.depth.utime, picture.utime);
    EXPECT_EQ(outputs_.albedo.utime, picture.utime);
    EXPECT_EQ(outputs_.vessels.utime, picture.utime);
    outputs_.counts.resize(static_cast<std::size_t>(outputs_.depth.width * outputs_.depth.height));
    const std::size_t bytes = 2 * outputs_.counts.size();
    EXPECT_EQ(ZSTD_decompress(outputs_.counts.data(), bytes, outputs_.depth.data.data(),
                              outputs_.depth.data.size()),
              bytes);
    return outputs_;
  }

  void expect_refused(const image_t& picture, const std::string& reason) {
    const Outputs& outputs = see(picture);
    EXPECT_THAT(outputs.metadata("failure"), Not(IsEmpty()));
    EXPECT_THAT(outputs.metadata("failure_message"), HasSubstr(reason));
    EXPECT_THAT(bus_->describe_health(), HasSubstr(reason));
    EXPECT_EQ(std::count(outputs.counts.begin(), outputs.counts.end(), 0),
              static_cast<std::ptrdiff_t>(outputs.counts.size()));
    EXPECT_EQ(std::count(outputs.albedo.data.begin(), outputs.albedo.data.end(), 0),
              static_cast<std::ptrdiff_t>(outputs.albedo.data.size()));
  }

  static Surface wall(double distance = kWallDistance) {
    return perception::plane_through({0, 0, distance}, {0.1, 0.05, -1});
  }

  double grain_ = kGrain;
  RigConfiguration rig_;
  std::map<std::string, int> published_;
  Outputs outputs_;
  MemoryNetwork network_;
  Bus* bus_ = nullptr;
  std::unique_ptr<DepthEstimatorProcess> process_;
  std::int64_t utime_ = 0;
};

TEST_F(DepthEstimatorProcessTest, PictureOfAKnownWallBecomesItsMetricDepth) {
  start();
  const Outputs& outputs = see(picture_of(wall()));
  EXPECT_THAT(outputs.metadata("failure"), IsEmpty());
  for (const auto& [u, v] : {std::pair{80, 58}, {30, 30}, {130, 90}}) {
    const double truth =
        wall()({(u - rig_.camera.cx) / rig_.camera.fx, (v - rig_.camera.cy) / rig_.camera.fy, 1})
            .position.z();
    EXPECT_NEAR(outputs.depth_at(u, v), truth, kPictureError * truth) << u << ", " << v;
  }
}

TEST_F(DepthEstimatorProcessTest, AlbedoIsTheSameFromNearAndFar) {
  start();
  const double green = rig_.depth_estimator.albedo[1];
  for (const double distance : {0.025, 0.035, 0.06}) {
    const Outputs& outputs = see(picture_of(wall(distance)));
    // Light goes with the square of the distance.
    EXPECT_NEAR(outputs.albedo_at(80, 58), 255 * green, 2 * kPictureError * 255 * green)
        << distance;
  }
}

TEST_F(DepthEstimatorProcessTest, ToldGainIsTakenOut) {
  rig_.camera.auto_exposure = true;
  start();
  for (const double gain : {0.7, 1.0, 2.0}) {
    image_t picture = picture_of(wall(0.05), gain);
    tell(picture, "gain", std::to_string(gain));
    EXPECT_NEAR(see(picture).depth_at(80, 58), 0.05, 2 * kPictureError * 0.05) << gain;
  }
}

TEST_F(DepthEstimatorProcessTest, UnknownGainWidensTheUncertainty) {
  rig_.camera.auto_exposure = true;
  start();
  image_t picture = picture_of(wall());
  tell(picture, "gain", "1");
  const double known = see(picture).depth.relative_std;
  const double unknown = see(picture_of(wall())).depth.relative_std;
  // Depth goes with the square root of the light.
  EXPECT_NEAR(std::sqrt(unknown * unknown - known * known),
              rig_.depth_estimator.unknown_gain_std / 2,
              kPictureError * rig_.depth_estimator.unknown_gain_std);
  for (const char* text : {"-nan", "inf", "2,5", "1.5x", "", "-1", "0", "1e-30"}) {
    image_t nonsense = picture_of(wall());
    tell(nonsense, "gain", text);
    EXPECT_NEAR(see(nonsense).depth.relative_std, unknown, kPictureError * unknown) << text;
  }
}

TEST_F(DepthEstimatorProcessTest, PictureThatTheLampCannotExplainIsRefused) {
  rig_.camera.auto_exposure = true;
  start();
  image_t picture = picture_of(wall());
  tell(picture, "gain", "1000");
  EXPECT_EQ(see(picture).metadata("failure"), "unexplained");
  EXPECT_EQ(outputs_.depth.relative_std, 1);
  image_t good = picture_of(wall());
  tell(good, "gain", "1");
  EXPECT_NEAR(see(good).depth_at(80, 58), kWallDistance, kPictureError * kWallDistance);
}

TEST_F(DepthEstimatorProcessTest, LessExplainedPictureSaysALargerUncertainty) {
  start();
  const double smooth = see(picture_of(wall())).depth.relative_std;
  grain_ = 3 * kGrain;
  EXPECT_GT(see(picture_of(wall())).depth.relative_std, smooth);
}

TEST_F(DepthEstimatorProcessTest, BlackHoleHasNoDepthEvenWithoutReadNoise) {
  rig_.camera.read_noise = 0;
  start();
  std::vector<std::uint8_t> rgb = photograph(wall());
  for (int v = 40; v < 70; ++v) {
    std::fill_n(rgb.begin() + 3 * (160 * v + 90), 3 * 30, std::uint8_t{0});
  }
  const Outputs& outputs = see(camera_message(to_jpeg(rgb, 160, 120)));
  EXPECT_EQ(outputs.counts[static_cast<std::size_t>(160 * 55 + 105)], 0);
  const double truth =
      wall()({(40 - rig_.camera.cx) / rig_.camera.fx, (58 - rig_.camera.cy) / rig_.camera.fy, 1})
          .position.z();
  EXPECT_NEAR(outputs.depth_at(40, 58), truth, 2 * kPictureError * truth);
}

TEST_F(DepthEstimatorProcessTest, QualityOfAVeiledPictureIsSaidToo) {
  start();
  std::vector<std::uint8_t> fluid;
  for (int i = 0; i < 160 * 120; ++i) fluid.insert(fluid.end(), {150, 140, 100});
  const Outputs& outputs = see(camera_message(to_jpeg(fluid, 160, 120)));
  EXPECT_EQ(outputs.metadata("failure"), "veiled");
  EXPECT_NEAR(std::stod(outputs.metadata("mean_level")), 140.0 / 255, 0.01);
}

TEST_F(DepthEstimatorProcessTest, WideCameraGivesDepthOnACoarserGrid) {
  rig_.depth_estimator.max_width = 80;
  start();
  const Outputs& outputs = see(picture_of(wall()));
  EXPECT_EQ(outputs.depth.width, 80);
  EXPECT_EQ(outputs.depth.height, 60);
  EXPECT_EQ(outputs.albedo.width, 160);
  EXPECT_DOUBLE_EQ(outputs.depth.fx, 41.6);
  // The first coarse pixel's centre lies between the first two fine ones'.
  EXPECT_DOUBLE_EQ(outputs.depth.cx, (80.4 - 0.5) / 2);
  EXPECT_NEAR(outputs.depth_at(40, 29), kWallDistance, kPictureError * kWallDistance);
}

TEST_F(DepthEstimatorProcessTest, SequenceNumberAndQualityTravelWithTheAlbedo) {
  start();
  image_t picture = picture_of(wall());
  tell(picture, "seq", "41");
  const Outputs& outputs = see(picture);
  EXPECT_EQ(outputs.metadata("seq"), "41");
  const std::vector<std::uint8_t> rgb = photograph(wall());
  double green = 0;
  for (std::size_t i = 1; i < rgb.size(); i += 3) green += rgb[i];
  constexpr double kJpegError = 0.01;
  EXPECT_NEAR(std::stod(outputs.metadata("mean_level")),
              green / (255 * static_cast<double>(rgb.size()) / 3), kJpegError);
  for (const char* key :
       {"sharpness", "mean_level", "saturated_fraction", "dark_fraction", "highlight_fraction"}) {
    EXPECT_THAT(outputs.metadata(key), Not(IsEmpty())) << key;
  }
}

TEST_F(DepthEstimatorProcessTest, SaturatedRedLeavesDepthToGreen) {
  start();
  // Red's light is 1.2 times full scale here, green's 0.7 times.
  image_t picture = picture_of(wall(), 2.2);
  tell(picture, "gain", "2.2");
  const Outputs& outputs = see(picture);
  EXPECT_GT(std::stod(outputs.metadata("saturated_fraction")), 0.1);
  EXPECT_NEAR(outputs.depth_at(80, 58), kWallDistance, kPictureError * kWallDistance);
}

TEST_F(DepthEstimatorProcessTest, BadPicturesAreNamedAndTheNextGoodOneWorks) {
  start();
  const image_t good = picture_of(wall());
  const auto recovers = [&] {
    image_t next = picture_of(wall());
    EXPECT_NEAR(see(next).depth_at(80, 58), kWallDistance, kPictureError * kWallDistance);
    EXPECT_THAT(outputs_.metadata("failure"), IsEmpty());
    EXPECT_EQ(bus_->state(), ProcessState::kRunning);
  };
  recovers();
  std::vector<std::uint8_t> truncated = good.data;
  truncated.resize(truncated.size() / 2);
  expect_refused(camera_message(truncated), "JPEG");
  recovers();
  expect_refused(camera_message({}), "JPEG");
  recovers();
  expect_refused(camera_message({'n', 'o', ' ', 'j', 'p', 'e', 'g'}), "JPEG");
  recovers();
  const std::size_t pixels = 3 * 160 * 120;
  expect_refused(camera_message(to_jpeg(std::vector<std::uint8_t>(pixels, 0), 160, 120)), "black");
  recovers();
  expect_refused(camera_message(to_jpeg(std::vector<std::uint8_t>(pixels, 255), 160, 120)),
                 "white");
  recovers();
  std::vector<std::uint8_t> fluid;
  for (std::size_t i = 0; i < pixels; i += 3) fluid.insert(fluid.end(), {150, 140, 100});
  expect_refused(camera_message(to_jpeg(fluid, 160, 120)), "veiled");
  recovers();
  expect_refused(camera_message(to_jpeg({128, 100, 100}, 1, 1)), "1x1");
  recovers();
  expect_refused(camera_message(to_jpeg(std::vector<std::uint8_t>(4 * pixels, 90), 320, 240)),
                 "320x240");
  recovers();
  image_t foreign = picture_of(wall());
  foreign.pixelformat = 12345;
  expect_refused(foreign, "12345");
  recovers();
  EXPECT_EQ(published_[channel::kDepth], 19);
  EXPECT_THAT(bus_->describe_health(), HasSubstr("9 of 19 pictures not used, last: pixel format"));
}

TEST_F(DepthEstimatorProcessTest, GreyPictureIsNoFailure) {
  start();
  std::vector<std::uint8_t> rgb = photograph(wall());
  image_t picture = camera_message({});
  picture.pixelformat = image_t::PIXEL_FORMAT_GRAY;
  picture.row_stride = 160;
  for (std::size_t i = 0; i < rgb.size(); i += 3) picture.data.push_back(rgb[i]);
  picture.size = static_cast<std::int32_t>(picture.data.size());
  EXPECT_NEAR(see(picture).depth_at(80, 58), kWallDistance, kPictureError * kWallDistance);
}

}  // namespace
}  // namespace gastronaut
