#include "visual_slam/visual_slam_process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "bus/memory_bus.hpp"
#include "gastronaut/capsule_state_t.hpp"
#include "gastronaut/map_deformation_t.hpp"
#include "gastronaut/map_surfels_t.hpp"
#include "gastronaut/visual_pose_t.hpp"
#include "numerics/parallel.hpp"
#include "process/channels.hpp"
#include "unit/procs/visual_slam/slam_scene.hpp"
#include "visual_slam/surfel_file.hpp"

namespace gastronaut {
namespace {

using slam::camera_at;
using slam::utime_of;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr int kOk = visual_pose_t::STATUS_OK;
constexpr int kDegraded = visual_pose_t::STATUS_DEGRADED;
constexpr int kLost = visual_pose_t::STATUS_LOST;
constexpr int kRelocalised = visual_pose_t::STATUS_RELOCALISED;
constexpr int kFrameBend = map_deformation_t::KIND_FRAME;
constexpr double kRelativeStd = 0.002;  // a sensor's
constexpr double kMetresPerCount = 2e-6;

RigConfiguration rig() {
  RigConfiguration configuration;
  CameraConfiguration& camera = configuration.camera;
  camera.width = slam::kCameraGrid.width;
  camera.height = slam::kCameraGrid.height;
  camera.fx = slam::kCameraGrid.fx;
  camera.fy = slam::kCameraGrid.fy;
  camera.cx = slam::kCameraGrid.cx;
  camera.cy = slam::kCameraGrid.cy;
  configuration.visual_slam.working_distance = slam::kWallDistance;
  configuration.visual_slam.map_interval = 0.2;
  configuration.visual_slam.save_interval = 0.1;
  // Nobody answers, so that the next picture is all that is waited for.
  configuration.lag.feedback = 1e-6;
  return configuration;
}

void set_data(depth_image_t& message, const std::vector<std::uint8_t>& data) {
  message.data = data;
  message.size = static_cast<std::int32_t>(data.size());
}
void set_data(image_t& message, const std::vector<std::uint8_t>& data) {
  message.data = data;
  message.size = static_cast<std::int32_t>(data.size());
}

void tell(image_t& picture, const std::string& key, const std::string& value) {
  image_metadata_t entry;
  entry.key = key;
  entry.value.assign(value.begin(), value.end());
  entry.n = static_cast<std::int32_t>(value.size());
  picture.metadata.push_back(entry);
  picture.nmetadata = static_cast<std::int32_t>(picture.metadata.size());
}

struct Pictures {
  depth_image_t depth{};
  image_t albedo{};
};

Pictures pictures_of(const SE3& map_T_camera, std::int64_t utime, double relative_std) {
  const slam::Frame frame = slam::look(map_T_camera, utime, relative_std);
  Pictures pictures;
  depth_image_t& depth = pictures.depth;
  depth.utime = utime;
  depth.width = frame.grid.width;
  depth.height = frame.grid.height;
  depth.fx = frame.grid.fx;
  depth.fy = frame.grid.fy;
  depth.cx = frame.grid.cx;
  depth.cy = frame.grid.cy;
  depth.metres_per_count = kMetresPerCount;
  depth.relative_std = relative_std;
  depth.encoding = depth_image_t::ENCODING_RAW;
  std::vector<std::uint8_t> bytes;
  for (const float metres : frame.depth.values) {
    const auto count = static_cast<unsigned>(std::lround(metres / kMetresPerCount));
    bytes.push_back(static_cast<std::uint8_t>(count & 0xFF));
    bytes.push_back(static_cast<std::uint8_t>(count >> 8));
  }
  set_data(depth, bytes);
  image_t& albedo = pictures.albedo;
  albedo.utime = utime;
  albedo.width = albedo.row_stride = frame.grid.width;
  albedo.height = frame.grid.height;
  albedo.pixelformat = image_t::PIXEL_FORMAT_GRAY;
  bytes.clear();
  for (const float value : frame.albedo.values) {
    bytes.push_back(static_cast<std::uint8_t>(std::lround(255 * value)));
  }
  set_data(albedo, bytes);
  return pictures;
}

Pictures pictures_at(int number, double relative_std = kRelativeStd) {
  return pictures_of(camera_at(number), utime_of(number), relative_std);
}

// x y z nx ny nz red radius confidence.
using Surfels = std::map<std::int32_t, std::array<float, 9>>;

using Message = std::vector<std::uint8_t>;

// The process, its inputs, and all that it says; what holds for every message is asked of each.
class Rig {
 public:
  // What sensor_fusion would say to a VISUAL_POSE.
  using Fusion = std::function<std::optional<capsule_state_t>(const visual_pose_t&)>;

  explicit Rig(const std::string& map_file = {}, const Fusion& fusion = {})
      : network_([this](const std::string& channel, Bytes payload, std::int64_t) {
          log.emplace_back(channel, Message(payload.begin(), payload.end()));
          if (channel == channel::kCapsuleState) return;
          outputs.emplace_back(payload.begin(), payload.end());
          if (channel == channel::kVisualPose) take_pose(payload);
          if (channel == channel::kMapSurfels) take_map(payload);
          if (channel == channel::kMapDeformation) {
            EXPECT_EQ(decode_message(payload, deformations.emplace_back()), DecodeResult::kOk);
          }
        }),
        bus(network_.connect()),
        process_(std::make_unique<VisualSlamProcess>(bus, rig(), map_file)) {
    if (!fusion) return;
    Bus& other = network_.connect();
    other.subscribe<visual_pose_t>("VISUAL_POSE", 1, [&other, fusion](const visual_pose_t& pose) {
      if (const auto state = fusion(pose)) other.publish("CAPSULE_STATE", *state);
    });
  }

  void inject(const depth_image_t& depth) { inject("DEPTH", encode_message(depth)); }
  void inject(const image_t& albedo) { inject("ALBEDO", encode_message(albedo)); }
  void inject(const std::string& channel, const std::vector<std::uint8_t>& payload) {
    log.emplace_back(channel, payload);
    network_.inject(channel, payload);
  }
  void run() { network_.run_until_idle(); }
  visual_pose_t see(const Pictures& pictures) {
    inject(pictures.albedo);
    inject(pictures.depth);
    run();
    EXPECT_EQ(poses.back().utime, pictures.depth.utime);
    return poses.back();
  }
  visual_pose_t see(int number) { return see(pictures_at(number)); }
  void follow(int begin, int end) {
    for (int number = begin; number < end; ++number) see(number);
  }
  void finish() {
    network_.finish([this](std::size_t number) {
      if (number == 0) process_->finish();
    });
  }

 private:
  void take_pose(Bytes payload) {
    visual_pose_t pose;
    ASSERT_EQ(decode_message(payload, pose), DecodeResult::kOk);
    poses.push_back(pose);
    double norm2 = 0;
    for (const double q : pose.orientation) norm2 += q * q;
    constexpr double kRounding = 1e-9;
    EXPECT_NEAR(norm2, 1, kRounding);
    EXPECT_TRUE(std::all_of(pose.position, pose.position + 3,
                            [](double value) { return std::isfinite(value); }));
    Matrix6d covariance;
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) covariance(i, j) = pose.covariance[i][j];
    }
    EXPECT_TRUE(slam::is_covariance(covariance)) << covariance;
    EXPECT_TRUE(std::isfinite(pose.icp_rms) && std::isfinite(pose.rgb_rms));
    EXPECT_TRUE(pose.inlier_fraction >= 0 && pose.inlier_fraction <= 1);
  }
  void take_map(Bytes payload) {
    map_surfels_t message;
    ASSERT_EQ(decode_message(payload, message), DecodeResult::kOk);
    EXPECT_TRUE(message.reset != 0 || maps > 0);
    ++maps;
    resets += message.reset;
    map_version = message.map_version;
    if (message.reset != 0) surfels.clear();
    for (const std::int32_t id : message.removed) surfels.erase(id);
    for (std::size_t k = 0; k < message.id.size(); ++k) {
      const std::array<float, 9> values = {message.x[k],
                                           message.y[k],
                                           message.z[k],
                                           message.nx[k],
                                           message.ny[k],
                                           message.nz[k],
                                           static_cast<float>(message.red[k]),
                                           message.radius[k],
                                           message.confidence[k]};
      EXPECT_TRUE(
          std::all_of(values.begin(), values.end(), [](float v) { return std::isfinite(v); }));
      surfels[message.id[k]] = values;
    }
  }

  MemoryNetwork network_;

 public:
  Bus& bus;
  std::vector<visual_pose_t> poses;
  int maps = 0;
  int resets = 0;
  int map_version = 0;
  Surfels surfels;  // as a listener has them
  std::vector<map_deformation_t> deformations;
  std::vector<Message> outputs;  // of visual_slam
  std::vector<std::pair<std::string, Message>> log;

 private:
  std::unique_ptr<VisualSlamProcess> process_;
};

void expect_at(const visual_pose_t& pose, const SE3& truth) {
  const SE3 estimate{
      {pose.orientation[0], pose.orientation[1], pose.orientation[2], pose.orientation[3]},
      {pose.position[0], pose.position[1], pose.position[2]}};
  const slam::PoseError error = slam::error_of(estimate, truth);
  EXPECT_LT(error.metres, slam::kPixelMetres);
  EXPECT_LT(error.radians, slam::kPixelRadians);
}

class VisualSlamProcessTest : public ::testing::Test {
 protected:
  VisualSlamProcessTest() {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::temp_directory_path() / (std::string("visual_slam_") + test->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~VisualSlamProcessTest() override { std::filesystem::remove_all(folder_); }
  std::string map_file(const std::string& name = "map") const { return (folder_ / name).string(); }

 private:
  std::filesystem::path folder_;
};

TEST_F(VisualSlamProcessTest, EachFrameHasItsPose) {
  Rig rig;
  for (int k = 0; k < 12; ++k) {
    const visual_pose_t pose = rig.see(k);
    EXPECT_EQ(pose.status, kOk) << k;
    expect_at(pose, camera_at(k));
  }
  EXPECT_EQ(rig.poses.size(), 12U);
  EXPECT_EQ(rig.bus.state(), ProcessState::kRunning);
}

// The listener has the map as it was kept at the end.
void expect_listener_has(const Rig& rig, const slam::SurfelArrays& kept) {
  Surfels expected;
  for (std::size_t k = 0; k < kept.size(); ++k) {
    if (!kept.holds(k)) continue;
    const float grey = std::round(255 * std::clamp(kept.albedo[k], 0.0F, 1.0F));
    expected[static_cast<std::int32_t>(k)] = {kept.x[k],  kept.y[k],      kept.z[k],
                                              kept.nx[k], kept.ny[k],     kept.nz[k],
                                              grey,       kept.radius[k], kept.confidence[k]};
  }
  EXPECT_GT(expected.size(), 1000U);
  EXPECT_TRUE(rig.surfels == expected);
}

TEST_F(VisualSlamProcessTest, IncrementsSumUpToTheMap) {
  for (const double relative_std : {kRelativeStd, 0.03}) {
    Rig rig(map_file(std::to_string(relative_std)));
    for (int k = 0; k < 30; ++k) rig.see(pictures_at(k, relative_std));
    // Farther off than it was: what was seen is now in free space, and removed.
    for (int k = 30; k < 50; ++k) {
      Pictures pictures = pictures_at(k, relative_std);
      pictures.depth.metres_per_count *= 1.1;
      rig.see(pictures);
    }
    rig.finish();
    EXPECT_GT(rig.maps, 3);
    EXPECT_EQ(rig.resets, 1);
    expect_listener_has(rig, slam::load_map(map_file(std::to_string(relative_std))).surfels);
  }
}

TEST_F(VisualSlamProcessTest, SameBytesOnAnyNumberOfThreads) {
  const auto outputs = [](int threads) {
    set_thread_count(threads);
    Rig rig;
    for (int k = 0; k < 20; ++k) rig.see(pictures_at(k, 0.03));
    rig.finish();
    set_thread_count(0);
    return rig.outputs;
  };
  const auto one = outputs(1);
  EXPECT_TRUE(one == outputs(2));
  EXPECT_TRUE(one == outputs(2));
}

TEST_F(VisualSlamProcessTest, DamagedPicturesAreLostAndTheNextIsNot) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const auto cut = [](auto& message) {
    auto data = message.data;
    data.resize(data.size() / 2);
    set_data(message, data);
  };
  const std::vector<std::function<void(Pictures&)>> faults = {
      [](Pictures& p) { p.depth.fx = 0; },
      [](Pictures& p) { p.depth.fx = -1; },
      [](Pictures& p) { p.depth.fy = kNan; },
      [](Pictures& p) { p.depth.fx = p.depth.fy = 1e300; },
      [](Pictures& p) { p.depth.fx = p.depth.fy = 1e-300; },
      [](Pictures& p) { p.depth.cx = kInfinity; },
      [](Pictures& p) { p.depth.cy = 1e9; },
      [](Pictures& p) { p.depth.metres_per_count = kInfinity; },
      [](Pictures& p) { p.depth.metres_per_count = 0; },
      [](Pictures& p) { p.depth.metres_per_count = -1; },
      [](Pictures& p) { p.depth.metres_per_count = kNan; },
      [](Pictures& p) { p.depth.metres_per_count = 1e-30; },
      [](Pictures& p) { p.depth.relative_std = kNan; },
      [](Pictures& p) { p.depth.relative_std = -0.1; },
      [](Pictures& p) { p.depth.relative_std = 1e300; },
      [](Pictures& p) { p.depth.encoding = 77; },
      [](Pictures& p) { p.depth.encoding = depth_image_t::ENCODING_PNG; },
      [](Pictures& p) { p.depth.encoding = depth_image_t::ENCODING_ZSTD; },
      [](Pictures& p) { p.depth.width = -p.depth.width; },
      [](Pictures& p) { p.depth.width = 0; },
      [](Pictures& p) { p.depth.height = std::numeric_limits<std::int32_t>::max(); },
      [](Pictures& p) { std::swap(p.depth.width, p.depth.height); },
      [&](Pictures& p) { cut(p.depth); },
      [](Pictures& p) { set_data(p.depth, {}); },
      [](Pictures& p) {  // a good depth of a quarter of the size
        p.depth.width /= 2;
        p.depth.height /= 2;
        p.depth.fx /= 2;
        p.depth.fy /= 2;
        p.depth.cx = (p.depth.cx - 0.5) / 2;
        p.depth.cy = (p.depth.cy - 0.5) / 2;
        set_data(p.depth, std::vector<std::uint8_t>(160 * 120 / 2, 58));
      },
      [](Pictures& p) { p.albedo.pixelformat = image_t::PIXEL_FORMAT_MJPEG; },
      [](Pictures& p) { p.albedo.pixelformat = 12345; },
      [](Pictures& p) { p.albedo.width *= 2; },
      [](Pictures& p) { p.albedo.height = -1; },
      [](Pictures& p) { p.albedo.row_stride = 0; },
      [&](Pictures& p) { cut(p.albedo); },
      [](Pictures& p) { set_data(p.albedo, {}); },
  };
  Rig rig;
  int k = 0;
  // First frames too.
  for (std::size_t fault = 0; fault < faults.size(); ++fault, ++k) {
    Pictures pictures = pictures_of({}, utime_of(k), kRelativeStd);
    faults[fault](pictures);
    EXPECT_EQ(rig.see(pictures).status, kLost) << fault;
    EXPECT_EQ(rig.bus.state(), ProcessState::kDegraded);
  }
  EXPECT_TRUE(rig.surfels.empty());
  rig.see(pictures_of({}, utime_of(k++), kRelativeStd));
  for (std::size_t fault = 0; fault < faults.size(); ++fault) {
    SCOPED_TRACE(fault);
    Pictures pictures = pictures_of({}, utime_of(k++), kRelativeStd);
    faults[fault](pictures);
    EXPECT_EQ(rig.see(pictures).status, kLost);
    const visual_pose_t pose = rig.see(pictures_of({}, utime_of(k++), kRelativeStd));
    EXPECT_NE(pose.status, kLost);
    expect_at(pose, {});
    EXPECT_EQ(rig.bus.state(), ProcessState::kRunning);
  }
  EXPECT_THAT(rig.bus.describe_health(), HasSubstr("frames lost, last cause: ALBEDO"));
}

TEST_F(VisualSlamProcessTest, FarDepthDoesNotBreakTheMap) {
  Rig rig(map_file());
  rig.follow(0, 5);
  Pictures pictures = pictures_at(5);
  pictures.depth.metres_per_count = 1e300;
  rig.see(pictures);
  const visual_pose_t pose = rig.see(6);
  EXPECT_EQ(pose.status, kOk);
  expect_at(pose, camera_at(6));
  rig.finish();
  EXPECT_NO_THROW(slam::load_map(map_file()));
}

TEST_F(VisualSlamProcessTest, RefusedPicturesSayWhy) {
  Rig rig;
  rig.follow(0, 3);
  Pictures black = pictures_at(3);
  set_data(black.depth, std::vector<std::uint8_t>(black.depth.data.size(), 0));
  set_data(black.albedo, std::vector<std::uint8_t>(black.albedo.data.size(), 0));
  black.depth.relative_std = 1;
  tell(black.albedo, "failure", "black");
  tell(black.albedo, "failure_message", "nothing is lit: does the lamp shine?");
  EXPECT_EQ(rig.see(black).status, kLost);
  EXPECT_EQ(rig.bus.state(), ProcessState::kDegraded);
  EXPECT_THAT(rig.bus.describe_health(),
              HasSubstr("1 of 4 frames lost, last cause: nothing is lit: does the lamp shine?"));
  expect_at(rig.see(4), camera_at(4));
  EXPECT_EQ(rig.bus.state(), ProcessState::kRunning);
}

TEST_F(VisualSlamProcessTest, BlurIsSaid) {
  const auto with = [](int number, const std::string& sharpness) {
    Pictures pictures = pictures_at(number);
    tell(pictures.albedo, "sharpness", sharpness);
    return pictures;
  };
  Rig rig;
  for (int k = 0; k < 5; ++k) rig.see(with(k, "0.02"));
  EXPECT_EQ(rig.see(with(5, "0.004")).status, kDegraded);
  EXPECT_THAT(rig.bus.describe_health(), HasSubstr("blur"));
  int k = 6;
  for (const char* nonsense : {"", "nan", "-inf", "1e999", "sharp", "0", "-1"}) {
    EXPECT_EQ(rig.see(with(k, nonsense)).status, kOk) << nonsense;
    ++k;
  }
}

TEST_F(VisualSlamProcessTest, OneOfTheTwoAloneIsLost) {
  Rig rig;
  rig.follow(0, 3);
  rig.inject(pictures_at(3).albedo);
  rig.see(4);
  ASSERT_EQ(rig.poses.size(), 5U);
  EXPECT_EQ(rig.poses[3].status, kLost);
  EXPECT_EQ(rig.poses[3].utime, utime_of(3));
  EXPECT_EQ(rig.poses[4].status, kOk);
  // ALBEDO stays away for longer than it is waited for.
  for (int k = 5; k < 35; ++k) {
    rig.inject(pictures_at(k).depth);
    rig.run();
  }
  EXPECT_THAT(rig.bus.describe_health(),
              AllOf(HasSubstr("DEPTH came without its ALBEDO"), HasSubstr("ALBEDO is silent")));
  for (int k = 35; k < 38; ++k) {
    rig.inject(pictures_of(camera_at(k - 31), utime_of(k), kRelativeStd).albedo);
    rig.inject(pictures_of(camera_at(k - 31), utime_of(k), kRelativeStd).depth);
    rig.run();
  }
  EXPECT_EQ(rig.poses.back().status, kOk);
  expect_at(rig.poses.back(), camera_at(6));
  rig.inject(pictures_at(38).albedo);
  rig.finish();
  ASSERT_EQ(rig.poses.size(), 39U);
  for (std::size_t k = 0; k < rig.poses.size(); ++k) {
    EXPECT_EQ(rig.poses[k].utime, utime_of(static_cast<int>(k)));
  }
  EXPECT_EQ(rig.poses.back().status, kLost);
}

TEST_F(VisualSlamProcessTest, OrderOfArrivalDoesNotMatterAndWhatIsLateIsDropped) {
  Rig rig;
  rig.follow(0, 3);
  for (const int k : {4, 3, 5}) {
    rig.inject(pictures_at(k).depth);
  }
  for (const int k : {5, 4, 3}) {
    rig.inject(pictures_at(k).albedo);
  }
  rig.run();
  ASSERT_EQ(rig.poses.size(), 6U);
  for (int k = 3; k < 6; ++k) {
    EXPECT_EQ(rig.poses[static_cast<std::size_t>(k)].status, kOk);
    expect_at(rig.poses[static_cast<std::size_t>(k)], camera_at(k));
  }
  for (const int late : {5, 1}) {  // the newest again, and an old one
    rig.inject(pictures_at(late).albedo);
    rig.inject(pictures_at(late).depth);
    rig.run();
  }
  EXPECT_EQ(rig.poses.size(), 6U);
  EXPECT_EQ(rig.bus.counters().late, 4);
  EXPECT_EQ(rig.see(6).status, kOk);
}

TEST_F(VisualSlamProcessTest, JumpIsLostUntilAPlaceIsKnownAgain) {
  const SE3 elsewhere{Eigen::Quaterniond::Identity(), {0.05, 0, 0}};
  Rig rig;
  rig.follow(0, 20);
  for (int k = 20; k < 23; ++k) {
    EXPECT_EQ(rig.see(pictures_of(elsewhere, utime_of(k), kRelativeStd)).status, kLost);
  }
  EXPECT_EQ(rig.bus.state(), ProcessState::kDegraded);
  const visual_pose_t found = rig.see(pictures_of(camera_at(5), utime_of(23), kRelativeStd));
  EXPECT_EQ(found.status, kRelocalised);
  expect_at(found, camera_at(5));
  EXPECT_EQ(rig.bus.state(), ProcessState::kRunning);
}

TEST_F(VisualSlamProcessTest, RestartGoesOnWithTheKeptMap) {
  Rig before(map_file());
  before.follow(0, 30);
  before.finish();
  Rig after(map_file());
  const visual_pose_t pose = after.see(pictures_of(camera_at(24), utime_of(40), kRelativeStd));
  EXPECT_EQ(pose.status, kRelocalised);
  expect_at(pose, camera_at(24));
  after.finish();
  EXPECT_GE(after.surfels.size(), before.surfels.size() / 2);  // announced as it was kept
  Rig without;
  EXPECT_EQ(without.see(pictures_of(camera_at(24), utime_of(40), kRelativeStd)).status, kOk);
  expect_at(without.poses.back(), {});  // a map of its own
}

// What was there when the process was killed, between two saves.
TEST_F(VisualSlamProcessTest, MapIsKeptWhileItGrows) {
  {
    Rig killed(map_file());
    killed.follow(0, 10);
  }
  EXPECT_GT(slam::load_map(map_file()).surfels.size(), 1000U);
  Rig after(map_file());
  const visual_pose_t pose = after.see(pictures_of(camera_at(3), utime_of(40), kRelativeStd));
  EXPECT_EQ(pose.status, kRelocalised);
  expect_at(pose, camera_at(3));
}

TEST_F(VisualSlamProcessTest, DamagedKeptMapIsSetAsideAndANewOneBegun) {
  Rig before(map_file());
  before.follow(0, 3);
  before.finish();
  const std::string path = map_file();
  std::filesystem::resize_file(path, std::filesystem::file_size(path) / 2);
  const auto size = std::filesystem::file_size(path);
  Rig after(path);
  EXPECT_EQ(std::filesystem::file_size(path + ".refused"), size);
  EXPECT_FALSE(std::filesystem::exists(path));
  after.follow(0, 3);
  after.finish();
  EXPECT_GT(slam::load_map(path).surfels.size(), 1000U);
}

TEST_F(VisualSlamProcessTest, MapThatCannotBeWrittenIsSaidAndTrackingGoesOn) {
  Rig rig(map_file("no/such/folder"));
  int k = 0;
  // The writer has a thread of its own; it is done within a few frames.
  constexpr int kMostFrames = 60;
  while (k < kMostFrames &&
         rig.bus.describe_health().find("the map is not kept") == std::string::npos) {
    const visual_pose_t pose = rig.see(k);
    EXPECT_EQ(pose.status, kOk);
    expect_at(pose, camera_at(k));
    ++k;
  }
  EXPECT_THAT(rig.bus.describe_health(),
              AllOf(HasSubstr("the map is not kept"), HasSubstr("check the folder")));
  rig.see(k);
  rig.finish();
  EXPECT_EQ(rig.poses.size(), static_cast<std::size_t>(k) + 1);
}

TEST_F(VisualSlamProcessTest, NothingSeenNothingKept) {
  Rig rig(map_file());
  rig.finish();
  EXPECT_TRUE(rig.outputs.empty());
  EXPECT_FALSE(std::filesystem::exists(map_file()));
}

// Where the scene is in the rig, and fusion that knows it.
const SE3 kRigTScene{so3_exp({2.5, 0.7, -0.4}), {0.02, -0.03, -0.06}};

capsule_state_t state_at(const SE3& scene_T_camera, std::int64_t utime) {
  constexpr double kVariance = 1e-8;  // of 0.1 mm and 0.1 mrad
  const SE3 rig_T_camera = kRigTScene * scene_T_camera;
  capsule_state_t state{};
  state.utime = utime;
  state.status = capsule_state_t::STATUS_NOMINAL;
  std::copy_n(rig_T_camera.translation.data(), 3, state.position);
  const Eigen::Quaterniond& q = rig_T_camera.rotation;
  const double wxyz[] = {q.w(), q.x(), q.y(), q.z()};
  std::copy_n(wxyz, 4, state.orientation);
  for (int i = 0; i < 6; ++i) state.covariance[i][i] = kVariance;
  state.depth_scale = 1;
  return state;
}
int number_of(std::int64_t utime) {
  return static_cast<int>((utime - slam::kStart) / slam::kPeriod);
}
capsule_state_t answer_to(const visual_pose_t& pose) {
  return state_at(camera_at(number_of(pose.utime)), pose.utime);
}

TEST_F(VisualSlamProcessTest, FusionTakesPosesAndMapToTheRig) {
  constexpr int kKnown = 13;  // frames until fusion knows where the capsule is
  for (const double relative_std : {kRelativeStd, 0.03}) {
    SCOPED_TRACE(relative_std);
    const std::string file = map_file(std::to_string(relative_std));
    Rig rig(file, [](const visual_pose_t& pose) {
      capsule_state_t state = answer_to(pose);
      if (number_of(pose.utime) < kKnown) state.status = capsule_state_t::STATUS_INITIALISING;
      return std::optional(state);
    });
    for (int k = 0; k < 40; ++k) rig.see(pictures_at(k, relative_std));
    for (std::size_t k = 0; k < rig.poses.size(); ++k) {
      const visual_pose_t& pose = rig.poses[k];
      EXPECT_EQ(pose.status, kOk) << k;
      // A keyframe may be being refined when it is time.
      EXPECT_TRUE(k > kKnown || pose.map_version == 0) << k;
      EXPECT_TRUE(k <= kKnown + 2 || pose.map_version == 1) << k;
    }
    if (relative_std == kRelativeStd) {
      expect_at(rig.poses[kKnown], camera_at(kKnown));
      expect_at(rig.poses.back(), kRigTScene * camera_at(39));
    }
    rig.finish();
    EXPECT_EQ(rig.resets, 2);
    EXPECT_EQ(rig.map_version, 1);
    EXPECT_EQ(rig.bus.describe_health(), "");
    expect_listener_has(rig, slam::load_map(file).surfels);
  }
}

TEST_F(VisualSlamProcessTest, BendsOfTheMapAreTold) {
  constexpr int kUntilThen = 20;  // frames; then fusion has the camera a millimetre further on
  constexpr double kDrift = 1e-3;
  const Eigen::Vector3d drift = kRigTScene.rotation * Eigen::Vector3d(0, 0, kDrift);
  const std::string file = map_file();
  Rig rig(file, [&drift](const visual_pose_t& pose) {
    capsule_state_t state = answer_to(pose);
    for (int i = 0; number_of(pose.utime) >= kUntilThen && i < 3; ++i) {
      state.position[i] += drift[i];
    }
    return std::optional(state);
  });
  for (int k = 0; k < 110; ++k) rig.see(pictures_at(k, 0.03));
  ASSERT_FALSE(rig.deformations.empty());
  const map_deformation_t& bend = rig.deformations.front();
  EXPECT_EQ(bend.kind, kFrameBend);
  EXPECT_EQ(bend.map_version, rig.poses.back().map_version);
  ASSERT_GT(bend.num_nodes, 0);
  EXPECT_GT(bend.num_constraints, 0);
  EXPECT_LT(bend.mean_constraint_error_after, bend.mean_constraint_error_before / 2);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const std::vector<double>& translation : bend.translation) {
    mean += Eigen::Vector3d(translation.data()) / bend.num_nodes;
  }
  constexpr double kPart = 0.5;  // some nodes had their cameras in place before
  EXPECT_GT(mean.dot(drift.normalized()), kPart * kDrift);
  EXPECT_THAT(rig.bus.describe_health(), HasSubstr("the map bent"));
  rig.finish();
  expect_listener_has(rig, slam::load_map(file).surfels);
}

TEST_F(VisualSlamProcessTest, ImpossibleStatesAreIgnoredAndSaid) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const std::vector<std::function<void(capsule_state_t&)>> faults = {
      [](auto& s) { s.position[1] = kNan; },
      [](auto& s) { s.position[1] = 1e300; },
      [](auto& s) { s.orientation[0] = kInfinity; },
      [](auto& s) { std::fill_n(s.orientation, 4, 0.0); },
      [](auto& s) { std::fill_n(s.orientation, 4, 1.0); },
      [](auto& s) { s.velocity[0] = kNan; },
      [](auto& s) { s.angular_velocity[2] = kInfinity; },
      [](auto& s) { s.covariance[0][0] = kNan; },
      [](auto& s) { s.covariance[2][4] = kInfinity; },
      [](auto& s) { s.covariance[5][5] = -1; },
      [](auto& s) { s.depth_scale = kNan; },
      [](auto& s) { s.depth_scale = 0; },
      [](auto& s) { s.depth_scale = -1; },
      [](auto& s) { s.depth_scale = 2.1; },
      [](auto& s) { s.depth_scale = 0.49; },
  };
  Rig rig({}, [&](const visual_pose_t& pose) {
    capsule_state_t state = answer_to(pose);
    faults[static_cast<std::size_t>(number_of(pose.utime)) % faults.size()](state);
    return std::optional(state);
  });
  for (int k = 0; k < 2 * static_cast<int>(faults.size()); ++k) {
    EXPECT_EQ(rig.see(k).status, kOk) << k;
    expect_at(rig.poses.back(), camera_at(k));
    EXPECT_TRUE(k == 0 || rig.bus.describe_health().find("CAPSULE_STATE") != std::string::npos);
  }
  EXPECT_EQ(rig.map_version, 0);
  EXPECT_EQ(rig.resets, 1);
}

TEST_F(VisualSlamProcessTest, SilentFusionIsSaidAndChangesNoPose) {
  const auto outputs = [](const Rig::Fusion& fusion) {
    Rig rig({}, fusion);
    for (int k = 0; k < 20; ++k) rig.see(pictures_at(k, 0.03));
    EXPECT_THAT(rig.bus.describe_health(),
                HasSubstr("sensor_fusion is silent: the map is merged at vision's own poses"));
    rig.finish();
    std::vector<Message> poses;
    for (const visual_pose_t& pose : rig.poses) poses.push_back(encode_message(pose));
    return poses;
  };
  const auto expected = outputs({});
  EXPECT_TRUE(outputs([](const auto&) { return std::nullopt; }) == expected);
}

TEST_F(VisualSlamProcessTest, FusionThatFallsSilentAndComesBackIsUsedAgain) {
  Rig rig({}, [](const visual_pose_t& pose) {
    const int number = number_of(pose.utime);
    return number < 10 || number >= 20 ? std::optional(answer_to(pose)) : std::nullopt;
  });
  for (int k = 0; k < 30; ++k) {
    EXPECT_EQ(rig.see(k).status, kOk) << k;
    const bool silent = k > 10 && k < 22;  // noticed, respectively said, a frame later
    EXPECT_EQ(rig.bus.describe_health().find("sensor_fusion is silent") != std::string::npos,
              silent)
        << k;
    expect_at(rig.poses.back(), k == 0 ? SE3{} : kRigTScene * camera_at(k));
  }
  EXPECT_EQ(rig.poses.back().map_version, 1);
}

// Frames that cannot be used are answered too: so the fused pose is known when it is needed.
TEST_F(VisualSlamProcessTest, LostVisionBeginsAgainWhereFusionHasTheCamera) {
  const SE3 elsewhere{Eigen::Quaterniond::Identity(), {0.1, 0, 0}};  // nothing in view is known
  constexpr int kMoved = 20;
  const auto truth = [&](int k) { return k < kMoved ? camera_at(k) : elsewhere * camera_at(k); };
  Rig rig({}, [&](const visual_pose_t& pose) {
    return std::optional(state_at(truth(number_of(pose.utime)), pose.utime));
  });
  rig.follow(0, kMoved);
  for (int k = kMoved; k < 26; ++k) {
    Pictures pictures = pictures_at(k);
    tell(pictures.albedo, "failure", "fluid");
    EXPECT_EQ(rig.see(pictures).status, kLost);
  }
  int k = 26;
  while (k < 40 && rig.see(pictures_of(truth(k), utime_of(k), kRelativeStd)).status == kLost) ++k;
  EXPECT_EQ(k, 26 + slam::frames_in(slam::VisualSlamOptions{}.restart_after));
  EXPECT_EQ(rig.poses.back().status, kRelocalised);
  EXPECT_EQ(rig.poses.back().map_version, 2);
  EXPECT_THAT(rig.bus.describe_health(), HasSubstr("began again by what fusion knows 1 times"));
  while (++k < 50) {
    EXPECT_EQ(rig.see(pictures_of(truth(k), utime_of(k), kRelativeStd)).status, kOk) << k;
  }
  rig.finish();
  EXPECT_EQ(rig.resets, 1);  // the map is still in the same frame
}

// What was said once, fed to it again.
TEST_F(VisualSlamProcessTest, SameBytesFromALogThatHasTheAnswers) {
  Rig rig({}, answer_to);
  for (int k = 0; k < 20; ++k) rig.see(pictures_at(k, 0.03));
  rig.finish();
  Rig again;
  for (const auto& [channel, payload] : rig.log) {
    if (channel == channel::kVisualPose || channel == channel::kMapSurfels) continue;
    again.inject(channel, payload);
    again.run();
  }
  again.finish();
  EXPECT_EQ(rig.poses.back().map_version, 1);
  EXPECT_EQ(again.outputs.size(), rig.outputs.size());
  EXPECT_TRUE(again.outputs == rig.outputs);
}

TEST_F(VisualSlamProcessTest, KeptMapInTheRigStaysThere) {
  {
    Rig before(map_file(), answer_to);
    before.follow(0, 30);
    before.finish();
  }
  Rig after(map_file(), answer_to);
  EXPECT_EQ(after.see(24).status, kRelocalised);
  for (int k = 25; k < 30; ++k) {
    EXPECT_EQ(after.see(k).status, kOk);
    expect_at(after.poses.back(), kRigTScene * camera_at(k));
    EXPECT_EQ(after.poses.back().map_version, 0);
  }
}

}  // namespace
}  // namespace gastronaut
