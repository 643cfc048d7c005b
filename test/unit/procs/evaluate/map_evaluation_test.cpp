// Whole logs with a map through the whole evaluation.
#include "evaluate/map_evaluation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <gastronaut/capsule_state_t.hpp>
#include <gastronaut/depth_image_t.hpp>
#include <gastronaut/map_deformation_t.hpp>
#include <gastronaut/map_surfels_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <gastronaut/rigid_transform_t.hpp>
#include <gastronaut/visual_pose_t.hpp>
#include <limits>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "bus/log_file.hpp"
#include "configuration/rig_configuration.hpp"
#include "evaluate/evaluate_process.hpp"
#include "evaluate/log_evaluation.hpp"
#include "evaluate/report.hpp"
#include "process/channels.hpp"
#include "sphere_mesh.hpp"

namespace gastronaut::evaluation {
namespace {

using testing::HasSubstr;

constexpr std::int64_t kPeriod = 100000;  // microseconds
constexpr int kFrames = 20;
constexpr int kSurfels = 10000;
constexpr double kOffset = 0.001;     // metres: all surfels lie outside of the sphere by this
constexpr double kDepthCount = 1e-6;  // metres
constexpr double kFloat = 1e-7;       // metres, rounding of floats at this size

// From inside the sphere, looking along z, moving along x.
SE3 true_pose(int frame) { return {so3_exp({0, 0, 0.02 * frame}), {0.0005 * frame, 0, 0.005}}; }
const SE3 kMapTRig{so3_exp({0.5, 1, -0.3}), {0.05, -0.02, 0.07}};

void append(map_surfels_t& message, std::int32_t id, const Eigen::Vector3d& rig_point,
            float confidence) {
  const Eigen::Vector3f position = (kMapTRig * rig_point).cast<float>();
  const Eigen::Vector3f normal = (kMapTRig.rotation * -rig_point.normalized()).cast<float>();
  message.id.push_back(id);
  message.x.push_back(position.x());
  message.y.push_back(position.y());
  message.z.push_back(position.z());
  message.nx.push_back(normal.x());
  message.ny.push_back(normal.y());
  message.nz.push_back(normal.z());
  message.red.push_back(100);
  message.green.push_back(100);
  message.blue.push_back(100);
  message.radius.push_back(0.0012F);
  message.confidence.push_back(confidence);
  message.num_surfels = static_cast<std::int32_t>(message.id.size());
}

map_surfels_t sphere_map(std::int32_t first_id) {
  map_surfels_t message{};
  message.utime = kFrames * kPeriod;
  const std::vector<Eigen::Vector3d> points = sample_surface(sphere_mesh(), kSurfels);
  for (int i = 0; i < kSurfels; ++i) {
    append(message, first_id + i,
           points[static_cast<std::size_t>(i)] * (1 + kOffset / kSphereRadius), 20);
  }
  return message;
}

// The sphere from inside.
depth_image_t true_depth(int frame) {
  depth_image_t message{};
  message.utime = frame * kPeriod;
  message.width = 160;
  message.height = 120;
  message.fx = message.fy = 75;
  message.cx = 79.5;
  message.cy = 59.5;
  message.metres_per_count = kDepthCount;
  const SE3 pose = true_pose(frame);
  for (int v = 0; v < message.height; ++v) {
    for (int u = 0; u < message.width; ++u) {
      const Eigen::Vector3d ray = pose.rotation * Eigen::Vector3d((u - message.cx) / message.fx,
                                                                  (v - message.cy) / message.fy, 1);
      // |c + d ray| = R
      const double b = pose.translation.dot(ray);
      const double c = pose.translation.squaredNorm() - kSphereRadius * kSphereRadius;
      const double depth = (-b + std::sqrt(b * b - ray.squaredNorm() * c)) / ray.squaredNorm();
      const auto count = static_cast<std::uint16_t>(std::lround(depth / kDepthCount));
      message.data.push_back(static_cast<std::uint8_t>(count & 0xFF));
      message.data.push_back(static_cast<std::uint8_t>(count >> 8));
    }
  }
  message.size = static_cast<std::int32_t>(message.data.size());
  return message;
}

class MapEvaluationTest : public testing::Test {
 protected:
  MapEvaluationTest() {
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
    write_ascii_ply(surface_, sphere_mesh());
  }

  struct Contents {
    bool with_truth = true;
    bool with_map = true;
    bool with_depth = false;
    std::vector<map_surfels_t> more = {};  // after the map
    std::vector<map_deformation_t> deformations = {};
    std::int32_t last_version = 0;  // of VISUAL_POSE in the second half of the log
    std::int32_t map_version = 0;   // of the map
    SE3 first_T_map = {};           // frame of VISUAL_POSE in the first half, from that of the map
    bool vision_lost = false;
    bool with_state = false;
  };

  void write_log(const Contents& contents) const {
    LogWriter log(log_);
    RigConfiguration configuration;
    configuration.camera.width = 64;
    configuration.camera.height = 48;
    configuration.camera.fx = configuration.camera.fy = 30;
    configuration.camera.cx = 31.5;
    configuration.camera.cy = 23.5;
    rig_config_t settings{};
    settings.yaml = write_configuration(configuration);
    log.write(channel::kRigConfig, settings);
    for (int frame = 0; frame < kFrames; ++frame) {
      const SE3 pose = true_pose(frame);
      rigid_transform_t truth{};
      truth.utime = frame * kPeriod;
      Eigen::Map<Eigen::Vector3d>(truth.trans) = pose.translation;
      truth.quat[0] = pose.rotation.w();
      Eigen::Map<Eigen::Vector3d>(truth.quat + 1) = pose.rotation.vec();
      if (contents.with_truth) log.write(channel::kGroundTruthPose, truth);
      const SE3 map_T_camera =
          (frame < kFrames / 2 ? contents.first_T_map : SE3{}) * kMapTRig * pose;
      visual_pose_t estimate{};
      estimate.utime = frame * kPeriod;
      estimate.map_version = frame < kFrames / 2 ? 0 : contents.last_version;
      Eigen::Map<Eigen::Vector3d>(estimate.position) = map_T_camera.translation;
      estimate.orientation[0] = map_T_camera.rotation.w();
      Eigen::Map<Eigen::Vector3d>(estimate.orientation + 1) = map_T_camera.rotation.vec();
      if (contents.vision_lost) estimate.status = visual_pose_t::STATUS_LOST;
      log.write(channel::kVisualPose, estimate);
      if (contents.with_state) {
        capsule_state_t state{};
        state.utime = frame * kPeriod;
        state.status = capsule_state_t::STATUS_NOMINAL;
        std::copy(truth.trans, truth.trans + 3, state.position);
        std::copy(truth.quat, truth.quat + 4, state.orientation);
        log.write(channel::kCapsuleState, state);
      }
      if (contents.with_depth) log.write(channel::kGroundTruthDepth, true_depth(frame));
    }
    if (contents.with_map) {
      map_surfels_t message = sphere_map(0);
      message.reset = true;
      message.map_version = contents.map_version;
      log.write(channel::kMapSurfels, message);
    }
    for (const map_surfels_t& message : contents.more) log.write(channel::kMapSurfels, message);
    for (const map_deformation_t& message : contents.deformations) {
      log.write(channel::kMapDeformation, message);
    }
    log.close();
  }

  nlohmann::json evaluate(const Contents& contents, bool with_surface = true) const {
    write_log(contents);
    evaluate_log(log_, folder_, {}, with_surface ? surface_ : "");
    std::ifstream file(folder_ + "/metrics.json");
    return nlohmann::json::parse(file);
  }

  std::string contents_of(const std::string& name) const {
    std::ifstream file(folder_ + "/" + name, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  std::string folder_ =
      testing::TempDir() + "/map_" + testing::UnitTest::GetInstance()->current_test_info()->name();
  std::string log_ = folder_ + "/derived.lcmlog";
  std::string surface_ = folder_ + "/surface.ply";
};

TEST_F(MapEvaluationTest, FindsTheErrorThatWasPutIn) {
  // In the middle of nowhere, but not stable.
  constexpr int kYoung = kSurfels / 2;
  map_surfels_t young{};
  for (int id = 0; id < kYoung; ++id) append(young, id, {0, 0, 0.5 * kSphereRadius}, 1);
  const nlohmann::json metrics = evaluate({.with_map = false, .more = {young, sphere_map(kYoung)}});
  EXPECT_EQ(metrics["map.surfels"], kYoung + kSurfels);
  EXPECT_EQ(metrics["map.stable"], kSurfels);
  EXPECT_EQ(metrics["map.refused"], 0);
  EXPECT_EQ(metrics["surface.count"], kSurfels);
  EXPECT_EQ(metrics["map.drawn"], "stable");
  EXPECT_EQ(metrics["surface.placement"], "trajectory");
  // No rigid motion brings one sphere nearer to another around the same centre.
  for (const char* how : {"trajectory", "handa", "paper"}) {
    const std::string key = std::string("surface.") + how;
    EXPECT_NEAR(metrics[key + ".mean"], kOffset, kSphereSagitta + kFloat) << how;
    EXPECT_NEAR(metrics[key + ".rmse"], kOffset, kSphereSagitta + kFloat) << how;
    EXPECT_NEAR(metrics[key + ".max"], kOffset, kSphereSagitta + kFloat) << how;
    EXPECT_EQ(metrics[key + ".within_1.5mm"], 1) << how;
  }
  EXPECT_GT(metrics["surface.none.mean"], 0.01);  // the map's frame is another than the rig's
  EXPECT_EQ(metrics["surface.accuracy.within_1.5mm"], 1);
  // 10 000 surfels on 201 square centimetres: 2.5 mm around a point there are ten of them.
  EXPECT_GT(metrics["surface.completeness.within_2.5mm"], 0.99);
  EXPECT_LT(metrics["surface.completeness.within_1.5mm"],
            metrics["surface.completeness.within_2.5mm"]);
  // The cone of view is less than half of the sphere.
  EXPECT_GT(metrics["surface.completeness.seen_share"], 0.1);
  EXPECT_LT(metrics["surface.completeness.seen_share"], 0.5);
  EXPECT_NEAR(metrics["surface.all.max"], 0.5 * kSphereRadius, kSphereSagitta + kFloat);

  // Colours reach to the errors of the young ones; the picture shows the others, with small errors.
  const cv::Mat picture = cv::imread(folder_ + "/map/outside_0_error.png");
  ASSERT_FALSE(picture.empty());
  int yellow = 0;  // value_colour of large errors
  for (int v = 0; v < picture.rows; ++v) {
    for (int u = 0; u < picture.cols; ++u) {
      const cv::Vec3b& pixel = picture.at<cv::Vec3b>(v, u);
      if (pixel[2] > 140 && pixel[1] > 140 && pixel[0] < 80) ++yellow;
    }
  }
  EXPECT_EQ(yellow, 0);
}

TEST_F(MapEvaluationTest, LeavesFilesThatAreTheSameEachTime) {
  evaluate({});
  constexpr std::size_t kBytes = 8 * 4 + 3;  // a surfel
  for (const char* name : {"map.ply", "map_error.ply"}) {
    const std::string file = contents_of(name);
    EXPECT_THAT(file, HasSubstr("element vertex 10000\n")) << name;
    const std::size_t header = file.find("end_header\n");
    ASSERT_NE(header, std::string::npos) << name;
    EXPECT_EQ(file.size() - header - std::string("end_header\n").size(), kSurfels * kBytes) << name;
  }
  EXPECT_THAT(contents_of("map_error.ply"), HasSubstr("viridis from 0 to 1"));
  const nlohmann::json views = nlohmann::json::parse(contents_of("map/views.json"));
  ASSERT_GE(views["outside"].size(), 2U);
  for (const char* kind : {"shape", "albedo", "error", "normals"}) {
    const std::string file = views["outside"][0]["files"][kind];
    EXPECT_THAT(contents_of("map/" + file), testing::StartsWith("\x89PNG")) << kind;
  }

  const auto read_all = [this] {
    std::map<std::string, std::string> files;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(folder_)) {
      const std::string name = std::filesystem::relative(entry.path(), folder_).string();
      if (entry.is_regular_file()) files[name] = contents_of(name);
    }
    return files;
  };
  const auto first = read_all();
  evaluate({});
  EXPECT_TRUE(first == read_all());
}

TEST_F(MapEvaluationTest, ThePageShowsTheMapAndHowFramesFitIt) {
  evaluate({});
  draw_report(folder_, surface_);
  for (const char* plot : {"map_outside_0", "map_errors", "map_size", "VISUAL_POSE_fit"}) {
    EXPECT_TRUE(std::filesystem::exists(folder_ + "/" + plot + ".png")) << plot;
  }
  const std::string page = contents_of("index.html");
  EXPECT_THAT(page, HasSubstr("Map against the true surface"));
  EXPECT_THAT(page, HasSubstr("10 000 stable surfels of 10 000"));
  EXPECT_THAT(page, testing::Not(HasSubstr("Bends of the map")));
}

TEST_F(MapEvaluationTest, RemovedAndChangedAndDamagedSurfelsCountAsTheyShould) {
  map_surfels_t change{};
  append(change, 0, {0, 0, kSphereRadius + 10 * kOffset}, 20);  // was there
  change.removed = {1, 2, 3, 3, -5, std::numeric_limits<std::int32_t>::max()};
  change.num_removed = static_cast<std::int32_t>(change.removed.size());
  map_surfels_t nonsense{};
  append(nonsense, -1, {0, 0, kSphereRadius}, 20);
  append(nonsense, 5, {0, 0, std::nan("")}, 20);
  append(nonsense, 6, {0, 0, kSphereRadius}, 20);
  nonsense.radius.back() = -1;
  const nlohmann::json metrics = evaluate({.more = {change, nonsense}});
  EXPECT_EQ(metrics["map.messages"], 3);
  EXPECT_EQ(metrics["map.surfels"], kSurfels - 3);
  EXPECT_EQ(metrics["map.refused"], 3);
  EXPECT_THAT(metrics.dump(), HasSubstr("3 surfels of MAP_SURFELS are none"));
  EXPECT_NEAR(metrics["surface.trajectory.max"], 10 * kOffset, kSphereSagitta + kFloat);
}

TEST_F(MapEvaluationTest, BendsOfTheMapAreCountedListedAndShown) {
  map_deformation_t loop{};
  loop.utime = 7 * kPeriod;
  loop.map_version = 2;
  loop.kind = map_deformation_t::KIND_LOCAL_LOOP;
  loop.num_nodes = 2;
  loop.position = {{0, 0, 0}, {0.01, 0, 0}};
  loop.affine.assign(2, {1, 0, 0, 0, 1, 0, 0, 0, 1});
  loop.translation = {{0.001, 0, 0}, {0.002, -0.003, 0.006}};
  loop.num_constraints = 12;
  loop.mean_constraint_error_before = 0.004;
  loop.mean_constraint_error_after = 0.0005;
  map_deformation_t unheard_of = loop;
  unheard_of.kind = 9;
  const nlohmann::json metrics = evaluate({.deformations = {loop, unheard_of}}, false);
  EXPECT_EQ(metrics["deformation.frame.count"], 0);
  EXPECT_EQ(metrics["deformation.local_loop.count"], 1);
  EXPECT_EQ(metrics["deformation.local_loop.error_before"], 0.004);
  EXPECT_EQ(metrics["deformation.local_loop.error_after"], 0.0005);
  EXPECT_NEAR(metrics["deformation.local_loop.largest_move"], 0.007, kFloat);
  EXPECT_EQ(metrics["messages.MAP_DEFORMATION.corrupt"], 1);
  EXPECT_THAT(contents_of("deformations.csv"),
              HasSubstr("700000,2,2,12,0.004,0.0005,0.007,local_loop\n"));
  draw_report(folder_, "");
  EXPECT_THAT(contents_of("index.html"), HasSubstr("local loop closure"));

  std::filesystem::remove(folder_ + "/deformations.csv");
  EXPECT_THAT(evaluate({}, false).dump(), testing::Not(HasSubstr("\"deformation.")));
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/deformations.csv"));
}

TEST_F(MapEvaluationTest, ComparesWithTheWallAsItWasSeenWithoutASurface) {
  const nlohmann::json metrics = evaluate({.with_depth = true}, false);
  // A pixel is half a millimetre of the sphere; a surfel behind it, up to 15 degrees aslant, is
  // within half of one (diagonally 0.38 mm) and 0.28 mm of it. There its tangent plane leaves the
  // sphere by 5.5 micrometres.
  constexpr double kTangent = 6e-6;
  EXPECT_NEAR(metrics["surface.seen.trajectory.mean"], kOffset, kSphereSagitta + kTangent);
  EXPECT_NEAR(metrics["surface.seen.trajectory.min"], kOffset, kSphereSagitta + kTangent);
  EXPECT_NEAR(metrics["surface.seen.trajectory.max"], kOffset, kSphereSagitta + kTangent);
  // The pictures see what completeness counts as in view, about a quarter of the sphere.
  EXPECT_GT(metrics["surface.seen.trajectory.count"], kSurfels / 10);
  EXPECT_LT(metrics["surface.seen.trajectory.count"], kSurfels / 2);
  EXPECT_FALSE(metrics.contains("surface.count"));
  draw_report(folder_, "");
  EXPECT_THAT(contents_of("index.html"), HasSubstr("against the wall as last seen"));
  EXPECT_FALSE(evaluate({}, false).contains("surface.seen.trajectory.count"));
}

TEST_F(MapEvaluationTest, SaysWhenMapFramesWereAlignedByThemselves) {
  EXPECT_THAT(evaluate({.last_version = 3}).dump(), HasSubstr("VISUAL_POSE has 2 map frames"));
  EXPECT_THAT(evaluate({}).dump(), testing::Not(HasSubstr("map frames")));
}

TEST_F(MapEvaluationTest, WithoutATrajectoryTheShapeSaysWhereTheMapBelongs) {
  const nlohmann::json metrics = evaluate({.with_truth = false});
  EXPECT_EQ(metrics["surface.placement"], "shape");
  EXPECT_NEAR(metrics["surface.shape.mean"], kOffset, kSphereSagitta + kFloat);
  EXPECT_GT(metrics["surface.none.mean"], 0.01);
  EXPECT_THAT(metrics.dump(), HasSubstr("it was put where its shape fits"));
  draw_report(folder_, surface_);
  EXPECT_THAT(contents_of("index.html"), HasSubstr("placed by its shape"));
}

TEST_F(MapEvaluationTest, FusionKeepsTheMapInTheRigsFrame) {
  // Where the log has fused poses but no truth the map is taken as it is.
  EXPECT_EQ(evaluate({.with_truth = false, .with_state = true})["surface.placement"], "none");
  // And with truth too, once it has gone there: vision's own poses may have drifted from it.
  EXPECT_EQ(evaluate({.map_version = 1, .with_state = true})["surface.placement"], "none");
  EXPECT_EQ(evaluate({.with_state = true})["surface.placement"], "trajectory");
}

TEST_F(MapEvaluationTest, PickedPairsPlaceTheMap) {
  write_log({});
  std::ofstream pairs(folder_ + "/pairs.csv");
  for (const Eigen::Vector3d& there :
       {Eigen::Vector3d(0, 0, 0.04), {0, 0.04, 0}, {0.04, 0, 0}, {-0.04, 0, 0}}) {
    const Eigen::Vector3d here = kMapTRig * there;
    pairs << here.x() << "," << here.y() << "," << here.z() << "," << there.x() << "," << there.y()
          << "," << there.z() << "\n";
  }
  pairs.close();
  evaluate_log(log_, folder_, {}, surface_, {}, folder_ + "/pairs.csv");
  const nlohmann::json metrics = nlohmann::json::parse(contents_of("metrics.json"));
  EXPECT_EQ(metrics["surface.placement"], "pairs");
  // The file has six digits: a micrometre at 0.1 m.
  constexpr double kDigits = 1e-6;
  EXPECT_NEAR(metrics["surface.pairs.mean"], kOffset, kSphereSagitta + kDigits);
}

TEST_F(MapEvaluationTest, ThePathDrawnIsTheFusedOneWhereThereIsOne) {
  const auto path_pixels = [&](const Contents& contents) {
    evaluate(contents, false);
    const cv::Mat picture = cv::imread(folder_ + "/map/outside_0_shape.png");
    cv::Mat path;
    cv::inRange(picture, cv::Scalar(12, 72, 232), cv::Scalar(12, 72, 232), path);
    return cv::countNonZero(path);
  };
  EXPECT_GT(path_pixels({}), 0);
  EXPECT_EQ(path_pixels({.vision_lost = true}), 0);
  EXPECT_GT(path_pixels({.vision_lost = true, .with_state = true}), 0);
}

TEST_F(MapEvaluationTest, TheMapIsPlacedByThePosesOfItsLastFrame) {
  const SE3 elsewhere{so3_exp({0, 0.2, 0}), {0.01, 0, 0}};
  const nlohmann::json last =
      evaluate({.last_version = 2, .map_version = 2, .first_T_map = elsewhere});
  EXPECT_NEAR(last["surface.trajectory.mean"], kOffset, kSphereSagitta + kFloat);
  // A bend leaves the frame what it was: all poses count, and these do not fit together.
  map_deformation_t bend{};
  bend.map_version = 1;
  bend.kind = map_deformation_t::KIND_FRAME;
  const nlohmann::json bent = evaluate(
      {.deformations = {bend}, .last_version = 1, .map_version = 1, .first_T_map = elsewhere});
  EXPECT_GT(bent["surface.trajectory.mean"], 2 * kOffset);
  // A version that no pose has.
  EXPECT_EQ(evaluate({.map_version = 9})["surface.placement"], "trajectory");
}

TEST_F(MapEvaluationTest, DamagedMessagesAreCountedAndDoNoHarm) {
  write_log({});
  std::filesystem::rename(log_, log_ + ".good");
  LogReader good(log_ + ".good");
  LogWriter log(log_);
  while (const auto event = good.next()) {
    log.write(event->channel, event->payload, event->log_utime);
    if (event->channel != channel::kMapSurfels) continue;
    // Cut off, and with an absurd number of surfels (after fingerprint, utime, version, reset).
    log.write(event->channel, event->payload.first(event->payload.size() / 2), event->log_utime);
    std::vector<std::uint8_t> absurd(event->payload.begin(), event->payload.end());
    absurd[8 + 8 + 4 + 1] = 0x7F;
    log.write(event->channel, Bytes(absurd), event->log_utime);
  }
  log.close();
  RecordedRun run = read_run(log_, [](double) {});
  EXPECT_EQ(run.channels[channel::kMapSurfels].corrupt, 2U);
  EXPECT_EQ(run.map.surfels.size(), std::size_t{kSurfels});
}

TEST_F(MapEvaluationTest, SaysWhatItCannotDo) {
  const nlohmann::json no_map = evaluate({.with_map = false});
  EXPECT_FALSE(no_map.contains("map.surfels"));
  EXPECT_FALSE(no_map.contains("surface.count"));
  const nlohmann::json no_surface = evaluate({}, false);
  EXPECT_EQ(no_surface["map.stable"], kSurfels);
  EXPECT_FALSE(no_surface.contains("surface.count"));
  const nlohmann::json no_truth = evaluate({.with_truth = false});
  EXPECT_EQ(no_truth["surface.placement"], "shape");
  EXPECT_FALSE(no_truth.contains("surface.completeness.within_1.5mm"));
  EXPECT_THAT(no_truth.dump(), HasSubstr("completeness"));
  map_surfels_t young{};
  young.reset = true;
  append(young, 1, {0, 0, kSphereRadius}, 1);
  const nlohmann::json unstable = evaluate({.more = {young}});
  EXPECT_EQ(unstable["map.surfels"], 1);
  EXPECT_FALSE(unstable.contains("surface.paper.mean"));
  EXPECT_NEAR(unstable["surface.all.mean"], 0, kSphereSagitta + kFloat);
  EXPECT_EQ(unstable["map.drawn"], "all");
  map_surfels_t nothing{};
  nothing.reset = true;
  EXPECT_FALSE(evaluate({.more = {nothing}}).contains("surface.all.mean"));
  EXPECT_THAT(unstable.dump(), HasSubstr("often enough to be stable"));
  std::ofstream(surface_) << "not a surface";
  EXPECT_THROW(evaluate_log(log_ + ".absent", folder_, {}, surface_), std::runtime_error);
  EXPECT_THROW(evaluate({}), std::runtime_error);
}

}  // namespace
}  // namespace gastronaut::evaluation
