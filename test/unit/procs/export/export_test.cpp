// Logs through the program, and what it wrote through the programs that others read it with.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <octomap/octomap.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <gastronaut/capsule_state_t.hpp>
#include <gastronaut/image_t.hpp>
#include <gastronaut/map_surfels_t.hpp>
#include <gastronaut/occupancy_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <gastronaut/rigid_transform_t.hpp>
#include <gastronaut/visual_pose_t.hpp>
#include <sstream>

#include "bus/log_file.hpp"
#include "geometry/se3.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

using testing::HasSubstr;

constexpr int kFrames = 40;
constexpr int kSurfelsAFrame = 5;
constexpr std::int64_t kStart = 1700000000000000;  // microseconds, as in recordings
constexpr std::int64_t kPeriod = 50000;
// Python that can import numpy is Debian's, which another one on PATH may hide.
constexpr const char* kPython = "/usr/bin/python3";

SE3 pose_at(int frame) {
  return {so3_exp({0.02 * frame, 0.01, -0.03 * frame}), {0.001 * frame, -0.02, 1.0 / (1 + frame)}};
}

template <class Message>
Message stamped(int frame) {
  Message message{};
  message.utime = kStart + frame * kPeriod;
  return message;
}

template <class Target>
void set_rotation(const SE3& pose, Target& orientation) {
  orientation[0] = pose.rotation.w();
  for (int i = 0; i < 3; ++i) orientation[i + 1] = pose.rotation.vec()[i];
}

class ExportTest : public testing::Test {
 protected:
  ExportTest() {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~ExportTest() override { std::filesystem::remove_all(folder_); }

  void write_log() const {
    LogWriter log(folder_ + "/in.lcmlog");
    for (int frame = 0; frame < kFrames; ++frame) {
      const SE3 pose = pose_at(frame);
      auto truth = stamped<rigid_transform_t>(frame);
      Eigen::Map<Eigen::Vector3d>(truth.trans) = pose.translation;
      set_rotation(pose, truth.quat);
      log.write(channel::kGroundTruthPose, truth);
      auto visual = stamped<visual_pose_t>(frame);
      Eigen::Map<Eigen::Vector3d>(visual.position) = pose.translation;
      set_rotation(pose, visual.orientation);
      visual.status = frame % 4 == 3 ? visual_pose_t::STATUS_LOST : visual_pose_t::STATUS_OK;
      log.write(channel::kVisualPose, visual);
      auto surfels = stamped<map_surfels_t>(frame);
      for (int i = 0; i < kSurfelsAFrame; ++i) {
        surfels.id.push_back(frame * kSurfelsAFrame + i);
        surfels.x.push_back(0.001F * static_cast<float>(frame));
        surfels.y.push_back(0.001F * static_cast<float>(i));
        surfels.z.push_back(0.05F);
        surfels.nx.push_back(0);
        surfels.ny.push_back(0);
        surfels.nz.push_back(-1);
        surfels.red.push_back(200);
        surfels.green.push_back(100);
        surfels.blue.push_back(50);
        surfels.radius.push_back(0.001F);
        surfels.confidence.push_back(12);
      }
      surfels.num_surfels = kSurfelsAFrame;
      log.write(channel::kMapSurfels, surfels);
    }
    auto picture = stamped<image_t>(0);
    picture.data.assign(1000, 1);
    picture.size = 1000;
    log.write("SIDE/CAMERA", picture);
    log.write("FOREIGN", Bytes(std::vector<std::uint8_t>(20, 3)), kStart);
    log.close();
  }

  int run(const std::string& arguments) const {
    const std::string line = "cd '" + folder_ + "' && '" GASTRONAUT_BINARY_DIR "/bin/export' " +
                             arguments + " >out.txt 2>err.txt";
    return WEXITSTATUS(std::system(line.c_str()));
  }

  // What the Python program prints; "SKIP: ..." where it cannot import what it needs.
  std::string python(const std::string& program) const {
    std::ofstream(folder_ + "/read.py") << program;
    const std::string line = "cd '" + folder_ + "' && " + kPython +
                             " read.py >py.txt 2>py_err.txt || cat py_err.txt >>py.txt";
    EXPECT_EQ(std::system(line.c_str()), 0);
    return read("py.txt");
  }

  std::string read(const std::string& name) const {
    std::ostringstream text;
    text << std::ifstream(folder_ + "/" + name).rdbuf();
    return text.str();
  }

  const std::string folder_ = testing::TempDir() + "export_" +
                              testing::UnitTest::GetInstance()->current_test_info()->name();
};

TEST_F(ExportTest, WritesEveryChannelAndSaysWhatItLeftOut) {
  write_log();
  ASSERT_EQ(run("in.lcmlog --out all --after-frames 10,20,100"), 0) << read("err.txt");
  for (const char* name : {"GROUND_TRUTH_POSE.csv", "GROUND_TRUTH_POSE.tum", "VISUAL_POSE.csv",
                           "VISUAL_POSE.tum", "MAP_SURFELS.csv", "SIDE_CAMERA.csv", "map.ply",
                           "mesh.ply", "map_after_10.ply", "map_after_20.ply"}) {
    EXPECT_TRUE(std::filesystem::exists(folder_ + "/all/" + name)) << name;
    EXPECT_THAT(read("out.txt"), HasSubstr(std::string(name) + "\n"));
  }
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/all/map_after_100.ply"));
  for (const auto& entry : std::filesystem::directory_iterator(folder_ + "/all")) {
    EXPECT_NE(entry.path().extension(), ".partial");
  }
  EXPECT_THAT(read("err.txt"), HasSubstr("map_after_100.ply: the log has 40 VISUAL_POSE"));
  EXPECT_THAT(read("err.txt"), HasSubstr("FOREIGN: 1 messages"));
  EXPECT_THAT(read("all/map_after_10.ply"), HasSubstr("element vertex 50\n"));
  EXPECT_THAT(read("all/map.ply"), HasSubstr("element vertex 200\n"));
}

TEST_F(ExportTest, TheMeshIsOfTheSurfelsThatTheConfigurationCallsStable) {
  write_log();
  ASSERT_EQ(run("in.lcmlog --out all --only mesh"), 0) << read("err.txt");
  EXPECT_EQ(read("out.txt"), "mesh.ply\n");
  LogWriter log(folder_ + "/strict.lcmlog");
  auto configuration = stamped<rig_config_t>(0);
  configuration.yaml = "visual_slam: {stable_confidence: 100}\n";
  log.write(channel::kRigConfig, configuration);
  LogReader weak(folder_ + "/in.lcmlog");
  while (const auto event = weak.next()) log.write(event->channel, event->payload, kStart);
  log.close();
  EXPECT_EQ(run("strict.lcmlog --out none --only mesh"), 1);
  EXPECT_THAT(read("err.txt"), HasSubstr("nothing to export"));
}

TEST_F(ExportTest, OnlyWhatIsAskedFor) {
  write_log();
  ASSERT_EQ(run("in.lcmlog --out tum --only tum"), 0);
  EXPECT_EQ(read("out.txt"), "GROUND_TRUTH_POSE.tum\nVISUAL_POSE.tum\n");
  EXPECT_EQ(run("in.lcmlog --out none --only octomap"), 1);
  EXPECT_THAT(read("err.txt"), HasSubstr("nothing to export"));
  EXPECT_EQ(run("in.lcmlog --out mesh --only obj"), 2);
  EXPECT_EQ(run("absent.lcmlog --out none"), 2);
  EXPECT_EQ(run("in.lcmlog --out out.txt/below"), 1);
}

TEST_F(ExportTest, ADamagedLogIsExportedUpToTheDamage) {
  write_log();
  std::filesystem::resize_file(folder_ + "/in.lcmlog",
                               std::filesystem::file_size(folder_ + "/in.lcmlog") / 2);
  ASSERT_EQ(run("in.lcmlog --out half"), 0);
  EXPECT_THAT(read("err.txt"), HasSubstr("everything before it was exported"));
  EXPECT_TRUE(std::filesystem::exists(folder_ + "/half/map.ply"));
}

TEST_F(ExportTest, TrajectoriesAreReadByNumpyAsEvoReadsThem) {
  write_log();
  ASSERT_EQ(run("in.lcmlog --out out --only tum"), 0);
  // evo.tools.file_interface: eight columns, # comments; x y z w.
  const std::string said = python(R"(
try:
    import numpy as np
except ImportError as problem:
    raise SystemExit(print("SKIP:", problem))
truth = np.loadtxt("out/GROUND_TRUTH_POSE.tum", comments="#")
visual = np.loadtxt("out/VISUAL_POSE.tum", comments="#")
print(truth.shape, visual.shape)
for row in (truth[7], visual[4]):  # of the visual ones each fourth was lost
    print(" ".join("%.9f" % value for value in row))
)");
  if (said.starts_with("SKIP:")) GTEST_SKIP() << "python3-numpy is not installed: " << said;
  std::istringstream lines(said);
  std::string shapes;
  std::getline(lines, shapes);
  EXPECT_EQ(shapes, "(40, 8) (30, 8)");
  constexpr double kDecimals = 1e-9;  // that the file has
  constexpr double kDoubleOfSeconds = 3e-7;
  for (const int frame : {7, 5}) {
    double row[8] = {};
    for (double& value : row) lines >> value;
    const SE3 pose = pose_at(frame);
    EXPECT_NEAR(row[0], 1e-6 * static_cast<double>(kStart + frame * kPeriod), kDoubleOfSeconds);
    EXPECT_LT((Eigen::Vector3d(row[1], row[2], row[3]) - pose.translation).norm(), kDecimals);
    const Eigen::Quaterniond rotation(row[7], row[4], row[5], row[6]);
    EXPECT_LT(angle_between(rotation.normalized(), pose.rotation), 10 * kDecimals);
  }
}

TEST_F(ExportTest, TablesAreReadByPythonsCsv) {
  write_log();
  ASSERT_EQ(run("in.lcmlog --out out --only csv"), 0);
  const std::string said = python(R"(
import csv
rows = list(csv.DictReader(open("out/VISUAL_POSE.csv", newline="")))
print(len(rows), len(rows[0]), sum(int(row["status"]) == 2 for row in rows))
print(float(rows[6]["position_2"]) == 1 / 7, rows[6]["utime"])
picture = next(csv.DictReader(open("out/SIDE_CAMERA.csv", newline="")))
print(picture["size"], "data" in picture)
)");
  // utime, version, status, 3 + 4 + 36 numbers, 3 residuals
  EXPECT_EQ(said, "40 49 10\nTrue 1700000000300000\n1000 False\n");
}

TEST_F(ExportTest, TheMapIsReadByOpen3D) {
  write_log();
  ASSERT_EQ(run("in.lcmlog --out out --only ply"), 0);
  const std::string said = python(R"(
try:
    import open3d
    import numpy as np
except ImportError as problem:
    raise SystemExit(print("SKIP:", problem))
cloud = open3d.io.read_point_cloud("out/map.ply")
points, normals, colours = (np.asarray(x) for x in (cloud.points, cloud.normals, cloud.colors))
print(len(points), np.allclose(points.max(axis=0), [0.039, 0.004, 0.05]),
      np.allclose(normals, [0, 0, -1]), np.round(255 * colours[0]).astype(int))
)");
  if (said.starts_with("SKIP:")) GTEST_SKIP() << "python3-open3d is not installed: " << said;
  EXPECT_EQ(said, "200 True True [200 100  50]\n");
}

TEST_F(ExportTest, TheOccupancyTreeIsReadByOctomapsTools) {
  if (std::system("command -v bt2vrml >/dev/null") != 0) {
    GTEST_SKIP() << "bt2vrml is not there: install octomap-tools";
  }
  octomap::OcTree tree(0.001);
  for (const float x : {0.0005F, 0.0105F, 0.0205F}) {  // apart: they are not pruned into one
    tree.updateNode(octomap::point3d(x, 0.0005F, 0.0005F), true);
  }
  std::ostringstream stream;
  ASSERT_TRUE(tree.writeBinaryConst(stream));
  const std::string bytes = stream.str();
  auto message = stamped<occupancy_t>(0);
  message.format = occupancy_t::FORMAT_BT;
  message.data.assign(bytes.begin(), bytes.end());
  message.size = static_cast<std::int32_t>(bytes.size());
  {
    LogWriter log(folder_ + "/in.lcmlog");
    log.write(channel::kOctomap, stamped<occupancy_t>(1));  // an empty one, and then the last
    log.write(channel::kOctomap, message);
    log.close();
  }
  ASSERT_EQ(run("in.lcmlog --out out --only octomap"), 0) << read("err.txt");
  EXPECT_EQ(read("out/octomap.bt"), bytes);
  ASSERT_EQ(std::system(("bt2vrml '" + folder_ + "/out/octomap.bt' >/dev/null 2>&1").c_str()), 0);
  const std::string boxes = read("out/octomap.bt.wrl");
  std::size_t count = 0;
  for (std::size_t at = 0; (at = boxes.find("Transform", at)) != std::string::npos; ++at) ++count;
  EXPECT_EQ(count, 3U);
}

}  // namespace
}  // namespace gastronaut
