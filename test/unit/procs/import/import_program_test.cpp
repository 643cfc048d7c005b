#include "import/import_program.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zstd.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <map>
#include <unordered_map>

#include "configuration/rig_configuration.hpp"
#include "import/files.hpp"
#include "synthetic_capture.hpp"

namespace gastronaut {
namespace {

using testing::HasSubstr;

int import(std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), "import");
  std::vector<char*> argv;
  for (std::string& argument : arguments) argv.push_back(argument.data());
  return run_import(static_cast<int>(argv.size()), argv.data());
}

std::string shared_data() {
  const char* given = std::getenv("GASTRONAUT_DATA");
  return given != nullptr ? given : GASTRONAUT_SOURCE_DIR "/../shared/data";
}

TEST(ImportProgram, ImportsACaptureFolder) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  EXPECT_EQ(import({"capture", "--set", "camera.gamma=1", folder.path(), "--out",
                    folder / "raw.lcmlog", "--epoch", "5"}),
            0);
  EXPECT_EQ(read_log(folder / "raw.lcmlog").front().utime, 5'000'000);
}

TEST(ImportProgram, WrongUsageAndConfigurationIsTwo) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  const std::string out = folder / "raw.lcmlog";
  EXPECT_EQ(import({}), 2);
  EXPECT_EQ(import({"capture", folder.path()}), 2);
  EXPECT_EQ(import({"capture", folder.path(), "--out", out, "--set", "camera.gama=1"}), 2);
  EXPECT_EQ(import({"video", folder / "rgb", "--out", out, "--camera", folder / "absent"}), 2);
  EXPECT_FALSE(std::filesystem::exists(out));
}

TEST(ImportProgram, AFullDiskIsAFailureThatLeavesNoLog) {
  if (!std::filesystem::exists("/dev/full")) GTEST_SKIP() << "no /dev/full on this host";
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  // LogWriter writes FILE.partial first.
  std::filesystem::create_symlink("/dev/full", folder / "raw.lcmlog.partial");
  testing::internal::CaptureStderr();
  EXPECT_EQ(import({"capture", folder.path(), "--out", folder / "raw.lcmlog"}), 1);
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("No space left on device"));
  EXPECT_FALSE(std::filesystem::exists(folder / "raw.lcmlog"));
}

TEST(ImportProgram, AnOutputFolderThatDoesNotExistIsAFailure) {
  const ScratchFolder folder;
  const SyntheticCapture capture(folder);
  EXPECT_EQ(import({"capture", folder.path(), "--out", folder / "absent/raw.lcmlog"}), 1);
}

// Nearest-vertex queries on the phantom's wall.
class Wall {
 public:
  explicit Wall(const std::string& ply) {
    const std::string text = read_text(ply);
    const std::string word = "element vertex ";
    const std::size_t count = std::stoul(text.substr(text.find(word) + word.size()));
    const std::string end = "end_header\n";
    const char* data = text.data() + text.find(end) + end.size();
    for (std::size_t i = 0; i < count; ++i) {
      Eigen::Vector3f vertex;
      std::memcpy(vertex.data(), data + i * sizeof(vertex), sizeof(vertex));
      cells_[key(cell(vertex))].push_back(vertex);
    }
  }

  // Metres; kCell when there is none nearer.
  double distance(const Eigen::Vector3f& point) const {
    double nearest = kCell;
    const Eigen::Vector3i centre = cell(point);
    for (int n = 0; n < 27; ++n) {
      const Eigen::Vector3i offset(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
      const auto found = cells_.find(key(centre + offset));
      if (found == cells_.end()) continue;
      for (const Eigen::Vector3f& vertex : found->second) {
        nearest = std::min(nearest, static_cast<double>((vertex - point).norm()));
      }
    }
    return nearest;
  }

 private:
  static constexpr double kCell = 0.004;
  static Eigen::Vector3i cell(const Eigen::Vector3f& point) {
    return (point / static_cast<float>(kCell)).array().floor().cast<int>();
  }
  static std::int64_t key(const Eigen::Vector3i& index) {
    constexpr std::int64_t kRange = 1 << 20;
    return (index.x() * kRange + index.y()) * kRange + index.z();
  }
  std::unordered_map<std::int64_t, std::vector<Eigen::Vector3f>> cells_;
};

TEST(ImportProgram, PhantomDepthLiesOnThePhantomsWall) {
  const std::string phantom = shared_data() + "/phantom_c";
  if (!std::filesystem::exists(phantom)) GTEST_SKIP() << phantom << " is not there";
  const ScratchFolder folder;
  const std::string log = folder / "raw.lcmlog";
  ASSERT_EQ(import({"capture", phantom, "--out", log}), 0);
  const auto events = read_log(log);
  EXPECT_EQ(read_channel<image_t>(events, "CAMERA").size(), 120U);
  EXPECT_EQ(read_channel<hall_array_t>(events, "HALL_ARRAY").size(), 600U);
  EXPECT_EQ(read_channel<coil_currents_t>(events, "COIL_CURRENTS").size(), 600U);
  const auto depths = read_channel<depth_image_t>(events, "GROUND_TRUTH_DEPTH");
  const auto poses = read_channel<rigid_transform_t>(events, "GROUND_TRUTH_POSE");
  ASSERT_EQ(depths.size(), 120U);
  ASSERT_EQ(poses.size(), 120U);

  const Wall wall(phantom + "/surface.ply");
  constexpr std::size_t kEveryFrame = 30;
  constexpr int kEveryPixel = 16;
  double sum = 0;
  int count = 0;
  for (std::size_t i = 0; i < depths.size(); i += kEveryFrame) {
    const depth_image_t& depth = depths[i];
    std::vector<std::uint16_t> counts(static_cast<std::size_t>(depth.width * depth.height));
    ZSTD_decompress(counts.data(), counts.size() * 2, depth.data.data(), depth.data.size());
    const Eigen::Quaterniond rotation(poses[i].quat[0], poses[i].quat[1], poses[i].quat[2],
                                      poses[i].quat[3]);
    for (int v = 0; v < depth.height; v += kEveryPixel) {
      for (int u = 0; u < depth.width; u += kEveryPixel) {
        const double z =
            counts[static_cast<std::size_t>(v * depth.width + u)] * depth.metres_per_count;
        if (z == 0) continue;
        const Eigen::Vector3d point(z * (u - depth.cx) / depth.fx, z * (v - depth.cy) / depth.fy,
                                    z);
        const Eigen::Vector3d in_rig = rotation * point + Eigen::Vector3d(poses[i].trans);
        sum += wall.distance(in_rig.cast<float>());
        ++count;
      }
    }
  }
  ASSERT_GT(count, 1000);
  // The wall's vertices are 0.8 mm apart: a point of it is 0.3 mm from the nearest on average.
  // Left distorted, the picture's outer half would be millimetres off.
  constexpr double kVertexSpacing = 0.8e-3;
  EXPECT_LT(sum / count, kVertexSpacing / 2);
}

TEST(ImportProgram, RealKinectRecordingIsImported) {
  const std::string data = shared_data() + "/tum_fr1_rpy_60";
  if (!std::filesystem::exists(data)) GTEST_SKIP() << data << " is not there";
  const ScratchFolder folder;
  const std::string camera = folder.write(
      "camera.yaml",
      "camera: {width: 640, height: 480, fx: 517.3, fy: 516.5, cx: 318.6, cy: 255.3, rate: 30}\n");
  const std::string log = folder / "raw.lcmlog";
  ASSERT_EQ(import({"tum", data, "--camera", camera, "--out", log}), 0);
  const auto events = read_log(log);
  EXPECT_EQ(read_channel<image_t>(events, "CAMERA").size(), 60U);
  const auto depths = read_channel<depth_image_t>(events, "DEPTH");
  ASSERT_EQ(depths.size(), 60U);
  EXPECT_EQ(depths[0].metres_per_count, 1.0 / 5000);
  EXPECT_EQ(depths[0].utime, 1305031229528748);  // of the colour picture, not its own
  EXPECT_GT(read_channel<rigid_transform_t>(events, "GROUND_TRUTH_POSE").size(), 60U);
}

}  // namespace
}  // namespace gastronaut
