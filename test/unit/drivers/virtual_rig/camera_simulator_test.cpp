#include "virtual_rig/camera_simulator.hpp"

#include <gtest/gtest.h>
#include <turbojpeg.h>

#include <cmath>
#include <numeric>

#include "small_scenario.hpp"

namespace gastronaut {
namespace {

std::vector<std::uint8_t> decode(const std::vector<std::uint8_t>& jpeg) {
  void* decoder = tjInitDecompress();
  int width = 0;
  int height = 0;
  int sampling = 0;
  int space = 0;
  EXPECT_EQ(
      tjDecompressHeader3(decoder, jpeg.data(), jpeg.size(), &width, &height, &sampling, &space),
      0);
  std::vector<std::uint8_t> picture(static_cast<std::size_t>(3 * width * height));
  EXPECT_EQ(tjDecompress2(decoder, jpeg.data(), jpeg.size(), picture.data(), width, 0, height,
                          TJPF_RGB, 0),
            0);
  tjDestroy(decoder);
  return picture;
}

double mean_level(const std::vector<std::uint8_t>& picture) {
  return std::accumulate(picture.begin(), picture.end(), 0.0) /
         static_cast<double>(picture.size()) / 255;
}

// Mean step between neighbours along the rows, grey levels of the red channel.
double sharpness(const std::vector<std::uint8_t>& picture) {
  double sum = 0;
  for (std::size_t i = 3; i < picture.size(); i += 3) sum += std::abs(picture[i] - picture[i - 3]);
  return 3 * sum / static_cast<double>(picture.size());
}

class CameraSimulatorTest : public ::testing::Test {
 protected:
  std::vector<CameraFrame> take(int frames) {
    const Organ organ(scenario_.organ);
    const Trajectory trajectory(scenario_.trajectory, organ.centreline(), SE3(), scenario_.seed);
    CameraSimulator camera(scenario_, organ, trajectory);
    std::vector<CameraFrame> taken;
    for (int i = 0; i < frames; ++i) taken.push_back(camera.take(i, i / scenario_.rig.camera.rate));
    return taken;
  }
  std::vector<std::uint8_t> first_picture() { return decode(take(1)[0].jpeg); }
  void add_fault(FaultKind kind, double strength) {
    FaultConfiguration fault;
    fault.kind = kind;
    fault.start = 0;
    fault.end = 100;
    fault.strength = strength;
    scenario_.faults.push_back(fault);
  }
  // One frame with the faults fully on.
  std::vector<std::uint8_t> later_picture() { return decode(take(10).back().jpeg); }

  VirtualRigScenario scenario_ = small_scenario();
};

TEST_F(CameraSimulatorTest, AutoExposureReachesItsTargetAndSaysHow) {
  scenario_.rig.camera.auto_exposure = true;
  scenario_.rig.camera.exposure_gain = 0.2;
  constexpr double kSettled = 0.03;  // grey level; the scene moves meanwhile
  const std::vector<CameraFrame> frames = take(20);
  EXPECT_EQ(frames.front().gain, 1);
  EXPECT_GT(frames.back().gain, 2);
  EXPECT_LT(mean_level(decode(frames.front().jpeg)), scenario_.imaging.target_level - kSettled);
  EXPECT_NEAR(mean_level(decode(frames.back().jpeg)), scenario_.imaging.target_level, kSettled);
}

TEST_F(CameraSimulatorTest, WithoutAutoExposureTheGainStaysOne) {
  for (const CameraFrame& frame : take(5)) EXPECT_EQ(frame.gain, 1);
}

TEST_F(CameraSimulatorTest, NoiseHasTheConfiguredStrength) {
  // Two seeds of the same view: their difference has sqrt(2) sigma, through the gamma's slope
  // 255 / gamma L^(1/gamma - 1), smoothed a little by JPEG.
  scenario_.imaging.jpeg_quality = 100;
  scenario_.rig.camera.read_noise = 0.02;
  scenario_.rig.camera.shot_noise = 0;
  scenario_.rig.camera.gamma = 1;  // the slope is 255 everywhere
  scenario_.rig.camera.exposure_gain = 0.5;
  scenario_.trajectory.kind = TrajectoryKind::kStatic;
  const std::vector<CameraFrame> frames = take(2);
  const std::vector<std::uint8_t> a = decode(frames[0].jpeg);
  const std::vector<std::uint8_t> b = decode(frames[1].jpeg);
  double sum = 0;
  std::size_t count = 0;
  for (std::size_t i = 1; i < a.size(); i += 3) {  // green: JPEG's luminance keeps it best
    sum += std::pow(a[i] - b[i], 2);
    ++count;
  }
  const double expected = std::sqrt(2) * scenario_.rig.camera.read_noise * 255;
  constexpr double kChromaSubsampling = 0.3;  // of the noise is lost in half-resolution colour
  EXPECT_NEAR(std::sqrt(sum / static_cast<double>(count)), expected, kChromaSubsampling * expected);
}

TEST_F(CameraSimulatorTest, TurbidFluidHidesTheWall) {
  const double clear = sharpness(later_picture());
  add_fault(FaultKind::kTurbid, 200);
  EXPECT_LT(sharpness(later_picture()), clear / 2);
}

TEST_F(CameraSimulatorTest, BlurTakesTheDetail) {
  scenario_.rig.camera.read_noise = scenario_.rig.camera.shot_noise = 0;
  const double clear = sharpness(later_picture());
  add_fault(FaultKind::kBlur, 5);
  EXPECT_LT(sharpness(later_picture()), clear / 2);
}

TEST_F(CameraSimulatorTest, OcclusionTurnsTheCoveredPartRed) {
  add_fault(FaultKind::kOcclusion, 1);
  const std::vector<std::uint8_t> picture = later_picture();
  double red = 0;
  double green = 0;
  for (std::size_t i = 0; i < picture.size(); i += 3) {
    red += picture[i];
    green += picture[i + 1];
  }
  EXPECT_GT(red, 2 * green);
}

TEST_F(CameraSimulatorTest, MotionBlursAlongTheWay) {
  CameraConfiguration& camera = scenario_.rig.camera;
  camera.width = camera.height = 160;  // enough pixels for vessels to be lines that can blur
  camera.fx = camera.fy = 100;
  camera.cx = camera.cy = 79.5;
  camera.read_noise = camera.shot_noise = 0;
  scenario_.organ.vessels = 5;
  scenario_.trajectory.path_length = 2;
  scenario_.trajectory.period = 5;
  scenario_.imaging.exposure = 0;
  const double frozen = sharpness(later_picture());
  scenario_.imaging.exposure = 0.05;
  EXPECT_LT(sharpness(later_picture()), 0.7 * frozen);
}

TEST_F(CameraSimulatorTest, DepthOfAClosedOrganHasNoHoles) {
  const CameraFrame frame = take(1)[0];
  for (const std::uint16_t count : frame.depth) EXPECT_GT(count, 0);
}

}  // namespace
}  // namespace gastronaut
