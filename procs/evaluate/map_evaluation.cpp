#include "evaluate/map_evaluation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>
#include <opencv2/imgcodecs.hpp>
#include <set>
#include <stdexcept>

#include "evaluate/picture_process.hpp"
#include "evaluate/seen_surface.hpp"
#include "evaluate/surface_errors.hpp"
#include "evaluate/surface_placement.hpp"
#include "evaluate/surface_thickness.hpp"
#include "evaluate/surfel_picture.hpp"
#include "process/channels.hpp"
#include "process/progress.hpp"
#include "surfels/surfel_file.hpp"

namespace gastronaut::evaluation {
namespace {

// metres: the target, and the target while the wall moves
constexpr std::array<std::pair<const char*, double>, 2> kLimits = {
    {{"within_1.5mm", 0.0015}, {"within_2.5mm", 0.0025}}};

// A way to put the map, and how far its points are from the surface then.
struct Comparison {
  std::string name;
  std::vector<double> distances;
};

struct Placed {
  std::string name = "none";  // as in the metrics
  SE3 rig_T_map;
  std::optional<ShapePlacement> by_shape = std::nullopt;
};

Points positions(const std::vector<Surfel>& surfels) {
  Points points;
  points.reserve(surfels.size());
  for (const Surfel& surfel : surfels) points.push_back(surfel.position.cast<double>());
  return points;
}

std::vector<Surfel> moved(const std::vector<Surfel>& surfels, const SE3& rig_T_map) {
  const Eigen::Matrix3f rotation = rig_T_map.rotation.toRotationMatrix().cast<float>();
  std::vector<Surfel> result = surfels;
  for (Surfel& surfel : result) {
    surfel.position = (rig_T_map * surfel.position.cast<double>()).cast<float>();
    surfel.normal = rotation * surfel.normal;
  }
  return result;
}

const PoseChannel* pose_channel(const RecordedRun& run, const char* name) {
  for (const PoseChannel& channel : run.pose_channels) {
    if (channel.name == name) return &channel;
  }
  return nullptr;
}

bool any_usable(const PoseChannel* poses) {
  return poses != nullptr && std::any_of(poses->fixes.begin(), poses->fixes.end(),
                                         [&](const auto& fix) { return poses->usable(fix); });
}

// The visual poses in the frame that the map ends in: those of its last version and of the versions
// before it from which only bends of the map led there. A new version that no bend explains is a
// new frame. All poses of the frame that has most of them, where the map's own has none.
PoseChannel poses_in_map(const RecordedRun& run) {
  const PoseChannel* all = pose_channel(run, channel::kVisualPose);
  if (all == nullptr) return {};
  std::set<std::int32_t> bends;
  for (const MapDeformation& bend : run.map.deformations) bends.insert(bend.map_version);
  std::int32_t first = run.map.version;
  while (bends.contains(first)) --first;
  PoseChannel chosen = *all;
  chosen.extras.clear();
  const auto keep = [&](std::int32_t from, std::int32_t to) {
    chosen.fixes.clear();
    for (const PoseFix& fix : all->fixes) {
      if (all->usable(fix) && fix.frame >= from && fix.frame <= to) chosen.fixes.push_back(fix);
    }
  };
  keep(first, run.map.version);
  if (chosen.fixes.empty()) keep(all->main_frame(), all->main_frame());
  return chosen;
}

// How far from the cameras the map typically is.
double viewing_distance(const PoseChannel& poses, const Points& points) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double count = 0;
  for (const PoseFix& fix : poses.fixes) {
    sum += fix.pose.translation;
    ++count;
  }
  std::vector<double> distances;
  for (const Eigen::Vector3d& point : points) distances.push_back((point - sum / count).norm());
  return quantile(distances, 0.5);
}

// `surface` may be null. Fusion takes the map to the rig's frame, with a new version, and keeps it
// there while vision drifts: then it needs no placing.
Placed place_map(const RecordedRun& run, const PoseChannel& poses, const Points& points,
                 const TrueSurface* surface, const std::string& pairs) {
  if (!pairs.empty()) return {"pairs", place_by_pairs(read_pairs(pairs))};
  const bool is_fused = any_usable(pose_channel(run, channel::kCapsuleState));
  if (is_fused && run.map.version > 0) return {};
  if (!poses.fixes.empty()) {
    const auto placement = place_by_trajectory(poses, run.truth, viewing_distance(poses, points));
    if (placement) return {"trajectory", *placement};
  }
  if (surface == nullptr || is_fused) return {};
  Progress progress("looking for the map's place on the surface");
  const ShapePlacement placement = place_by_shape(*surface, points);
  return {"shape", placement.rig_T_map, placement};
}

// The share of what the cameras saw of the surface that has a surfel nearby.
void set_completeness(Metrics& metrics, const TrueSurface& surface, const Points& stable,
                      const Points& all, const SE3& rig_T_map, RecordedRun& run) {
  if (!run.configuration || run.truth.empty()) {
    run.notes.push_back(
        "there is no RIG_CONFIG or no GROUND_TRUTH_POSE in the log: how much of the surface was in "
        "view is unknown, so nothing is said about the map's completeness");
    return;
  }
  constexpr std::size_t kSamples = 100000;
  constexpr std::size_t kMostPoses = 200;
  std::vector<SE3> poses;
  const std::vector<SE3>& truth = run.truth.poses();
  for (std::size_t i = 0; i < truth.size(); i += truth.size() / kMostPoses + 1) {
    poses.push_back(truth[i]);
  }
  Points seen = points_in_view(surface, sample_surface(surface.mesh(), kSamples),
                               CameraModel(run.configuration->camera.intrinsics()), poses);
  const std::string key = "surface.completeness.";
  metrics.set(key + "seen_share", static_cast<double>(seen.size()) / kSamples);
  if (seen.empty()) return;
  const SE3 map_T_rig = rig_T_map.inverse();
  for (Eigen::Vector3d& point : seen) point = map_T_rig * point;
  const auto set = [&](const std::string& which, const Points& cloud) {
    const std::vector<double> distances = cloud_distances(seen, cloud, kLimits.back().second);
    for (const auto& [name, limit] : kLimits) {
      metrics.set(key + which + name, share_within(distances, limit));
    }
  };
  set("", stable);
  set("all.", all);
}

void write_histogram(const std::string& path, const std::vector<Comparison>& comparisons) {
  constexpr std::size_t kBins = 200;
  // A map that is not aligned may be far off: the bins are for those that are.
  double largest = std::numeric_limits<double>::infinity();
  for (const Comparison& comparison : comparisons) {
    largest = std::min(largest, 2 * quantile(comparison.distances, 0.995));
  }
  const double width = std::max(largest, 1e-6) / kBins;
  std::ofstream file(path);
  file << "near,far";
  for (const Comparison& comparison : comparisons) file << "," << comparison.name;
  file << "\n";
  std::vector<std::vector<std::size_t>> counts;
  for (const Comparison& comparison : comparisons) {
    std::vector<std::size_t>& bins = counts.emplace_back(kBins);
    for (const double distance : comparison.distances) {
      const double bin = distance / width;
      if (bin < kBins) ++bins[static_cast<std::size_t>(bin)];
    }
  }
  for (std::size_t bin = 0; bin < kBins; ++bin) {
    file << static_cast<double>(bin) * width << "," << static_cast<double>(bin + 1) * width;
    for (const auto& bins : counts) file << "," << bins[bin];
    file << "\n";
  }
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

std::string place_words(const ShapePlacement& placement) {
  const auto millimetres = [](double metres) {
    std::array<char, 32> text{};
    std::snprintf(text.data(), text.size(), "%.3f mm", 1e3 * metres);
    return std::string(text.data());
  };
  if (std::isnan(placement.next_rmse)) return "No other place was found.";
  return "The next best place leaves " + millimetres(placement.next_rmse) + " RMS instead of " +
         millimetres(placement.rmse) + ": if these are alike, the place is a guess.";
}

// Of all surfels where `placed` puts them; the figures are of the stable ones but for surface.all.
std::vector<double> set_surface_metrics(Metrics& metrics, const std::string& folder,
                                        const TrueSurface& surface, const Placed& placed,
                                        const Points& stable, const Points& all, RecordedRun& run) {
  Progress progress("comparing the map with the true surface");
  metrics.set_count("surface.count", stable.size());
  metrics.set("surface.placement", placed.name);
  if (placed.by_shape) {
    metrics.set("surface.shape.next_rmse", placed.by_shape->next_rmse);
    run.notes.push_back(
        "no trajectory and no picked points say where the map belongs: it was put where its shape "
        "fits the true surface best, so its errors are the least possible ones. " +
        place_words(*placed.by_shape));
  }
  std::vector<Comparison> comparisons;
  const auto compare = [&](const std::string& name, const SE3& rig_T_map) {
    comparisons.push_back({name, surface_distances(surface, stable, rig_T_map)});
    const std::vector<double>& distances = comparisons.back().distances;
    const std::string key = "surface." + name;
    metrics.set_statistics(key, distances);
    for (const auto& [limit_name, limit] : kLimits) {
      metrics.set(key + "." + limit_name, share_within(distances, limit));
      if (name == placed.name) {
        metrics.set(std::string("surface.accuracy.") + limit_name, share_within(distances, limit));
      }
    }
    constexpr double kWays = 5;
    progress.update(static_cast<double>(comparisons.size()) / kWays);
  };
  const auto compare_aligned = [&](const std::string& name, const IcpResult& aligned) {
    compare(name, aligned.rig_T_map);
    const SE3 correction = aligned.rig_T_map * placed.rig_T_map.inverse();
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& point : stable) middle += point;
    middle /= static_cast<double>(stable.size());
    const std::string key = "surface." + name;
    metrics.set_count(key + ".iterations", static_cast<std::size_t>(aligned.iterations));
    metrics.set(key + ".turned_deg", so3_log(correction.rotation).norm() * 180 / std::numbers::pi);
    metrics.set(key + ".moved", (aligned.rig_T_map * middle - placed.rig_T_map * middle).norm());
  };
  if (stable.empty()) {
    run.notes.push_back(
        "no surfel of the map was ever seen often enough to be stable: only surface.all is set");
  } else {
    compare("none", SE3{});
    if (placed.name != "none") compare(placed.name, placed.rig_T_map);
    compare_aligned("handa", align_as_handa(surface, stable, placed.rig_T_map));
    compare_aligned("paper", align_as_the_paper(surface, stable, placed.rig_T_map));
    write_histogram(folder + "/surface_histogram.csv", comparisons);
  }
  std::vector<double> distances = surface_distances(surface, all, placed.rig_T_map);
  metrics.set_statistics("surface.all", distances);
  set_completeness(metrics, surface, stable, all, placed.rig_T_map, run);
  return distances;
}

void set_seen_metrics(Metrics& metrics, const std::string& log, const Placed& placed,
                      std::span<const Surfel> stable, const RecordedRun& run) {
  const auto truth = run.channels.find(channel::kGroundTruthDepth);
  if (truth == run.channels.end() || run.truth.empty() || stable.empty()) return;
  constexpr std::size_t kMostSurfels = 50000;  // spread over all
  std::vector<Surfel> sample;
  for (std::size_t i = 0; i < stable.size(); i += stable.size() / kMostSurfels + 1) {
    sample.push_back(stable[i]);
  }
  std::vector<std::pair<std::string, SeenSurface>> ways = {{"none", SeenSurface(sample, SE3{})}};
  if (placed.name != "none") {
    ways.emplace_back(placed.name, SeenSurface(sample, placed.rig_T_map));
  }
  Progress progress("comparing the map with what the camera saw");
  read_true_depths(
      log,
      [&](std::int64_t utime, const DepthPicture& picture) {
        const auto rig_T_camera = run.truth.at(utime);
        if (!rig_T_camera) return;
        for (auto& [name, seen] : ways) seen.add(utime, picture, *rig_T_camera);
      },
      [&progress](double fraction) { progress.update(fraction); });
  for (const auto& [name, seen] : ways) {
    const std::vector<double> distances = seen.distances();
    const std::string key = "surface.seen." + name;
    metrics.set_count(key + ".count", distances.size());
    metrics.set_statistics(key, distances);
    for (const auto& [limit_name, limit] : kLimits) {
      if (!distances.empty()) metrics.set(key + "." + limit_name, share_within(distances, limit));
    }
  }
}

void write_sizes(const std::string& path, const std::vector<MapSize>& sizes) {
  std::ofstream file(path);
  file << "utime,surfels,stable\n";
  for (const MapSize& size : sizes) {
    file << size.utime << "," << size.surfels << "," << size.stable << "\n";
  }
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

// The next of 1, 1.5, 2, 3, 5, 7, 10, 15, ... thousandths of a metre.
double round_limit(double value) {
  const double power = std::pow(10.0, std::floor(std::log10(value)));
  for (const double step : {1.0, 1.5, 2.0, 3.0, 5.0, 7.0}) {
    if (step * power >= value) return step * power;
  }
  return 10 * power;
}

void write_error_file(const std::string& path, std::vector<Surfel> surfels,
                      const std::vector<float>& errors, double limit) {
  for (std::size_t i = 0; i < surfels.size(); ++i) {
    const auto [blue, green, red] = value_colour(errors[i] / static_cast<float>(limit));
    surfels[i].colour = {red, green, blue};
  }
  write_surfels(path, surfels,
                "rig frame, coloured by the distance from the true surface, " +
                    std::string(kValueColours) + " from 0 to " + std::to_string(1e3 * limit) +
                    " mm");
}

// Albedo is relative: brightened so that all but the brightest 2 % stay below white.
void brighten(std::vector<Surfel>& surfels) {
  std::vector<double> levels;
  for (const Surfel& surfel : surfels) {
    levels.push_back(*std::max_element(surfel.colour.begin(), surfel.colour.end()));
  }
  const double factor = 255 / std::max(quantile(levels, 0.98), 1.0);
  for (Surfel& surfel : surfels) {
    for (std::uint8_t& level : surfel.colour) {
      level = static_cast<std::uint8_t>(std::lround(std::min(255.0, factor * level)));
    }
  }
}

// Pictures of one map, as files and as a list of them for report.py.
class MapPictures {
 public:
  MapPictures(const std::string& folder, const std::vector<Surfel>& surfels,
              const std::vector<float>& errors, double error_limit)
      : folder_(folder + "/map"), surfels_(surfels), errors_(errors), error_limit_(error_limit) {
    std::error_code error;
    std::filesystem::create_directories(folder_, error);
    if (error) throw std::runtime_error("cannot make " + folder_ + ": " + error.message());
    index_["error_limit"] = error_limit;
    index_["error_colours"] = kValueColours;
    index_["outside"] = nlohmann::ordered_json::array();
    index_["frames"] = nlohmann::ordered_json::array();
  }

  void draw_outside(const Viewpoint& view, std::span<const Line> lines) {
    auto& list = index_["outside"];
    auto entry = draw("outside_" + std::to_string(list.size()), view, lines).first;
    // In the middle of the map.
    const double distance = (view.world_T_view.inverse() * middle()).z();
    entry["metres_per_pixel"] = distance / view.grid.fx;
    list.push_back(std::move(entry));
  }

  // As the camera saw it; not shown where the map has next to nothing.
  void draw_inside(const ShownFrame& frame, double seconds, const SE3& rig_T_camera) {
    constexpr double kLeastCovered = 0.02;
    constexpr int kLeastWidth = 640;
    const PinholeGrid grid = finer(*frame.grid, (kLeastWidth - 1) / frame.grid->width + 1);
    auto [entry, share] = draw("frame_" + std::to_string(frame.number), {grid, rig_T_camera}, {});
    if (share < kLeastCovered) return;
    entry["number"] = frame.number;
    entry["seconds"] = seconds;
    entry["covered"] = share;
    index_["frames"].push_back(std::move(entry));
  }

  void write_index() const {
    const std::string path = folder_ + "/views.json";
    std::ofstream file(path);
    file << index_.dump(1) << "\n";
    if (!file.flush()) throw std::runtime_error("cannot write " + path);
  }

 private:
  Eigen::Vector3d middle() const {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const Surfel& surfel : surfels_) sum += surfel.position.cast<double>();
    return sum / static_cast<double>(surfels_.size());
  }

  std::pair<nlohmann::ordered_json, double> draw(const std::string& name, const Viewpoint& view,
                                                 std::span<const Line> lines) const {
    const SurfelDrawing drawing = draw_surfels(surfels_, errors_, view);
    auto files = nlohmann::ordered_json::object();
    const auto write = [&](const char* kind, Look look) {
      ColourPicture picture = paint(drawing, look, static_cast<float>(error_limit_), lines);
      const std::string file = name + "_" + kind + ".png";
      const cv::Mat pixels(picture.height, picture.width, CV_8UC3, picture.values.data());
      if (!cv::imwrite(folder_ + "/" + file, pixels)) {
        throw std::runtime_error("cannot write " + folder_ + "/" + file);
      }
      files[kind] = file;
    };
    write("shape", Look::kShape);
    write("albedo", Look::kColour);
    if (!errors_.empty()) write("error", Look::kValue);
    write("normals", Look::kNormals);
    nlohmann::ordered_json entry;
    entry["files"] = files;
    return {entry, covered(drawing)};
  }

  std::string folder_;
  const std::vector<Surfel>& surfels_;
  const std::vector<float>& errors_;
  double error_limit_;
  nlohmann::ordered_json index_;
};

// Camera poses in the frame that the placed map is in, by vision or else by truth.
std::optional<SE3> camera_pose(const RecordedRun& run, const PoseChannel& poses,
                               const Placed& placed, std::int64_t utime) {
  for (const PoseFix& fix : poses.fixes) {
    if (fix.utime == utime) return placed.rig_T_map * fix.pose;
  }
  return run.truth.at(utime);
}

// What fusion says, or without it vision in the map's frame.
Points estimated_path(const RecordedRun& run, const PoseChannel& poses, const Placed& placed) {
  Points path;
  if (const PoseChannel* states = pose_channel(run, channel::kCapsuleState)) {
    for (const PoseFix& fix : states->fixes) {
      if (states->usable(fix)) path.push_back(fix.pose.translation);
    }
    if (!path.empty()) return path;
  }
  for (const PoseFix& fix : poses.fixes) path.push_back(placed.rig_T_map * fix.pose.translation);
  return path;
}

void draw_map(const std::string& folder, const std::vector<Surfel>& surfels,
              const std::vector<float>& errors, double error_limit, const Placed& placed,
              const PoseChannel& poses, std::span<const ShownFrame> frames,
              const RecordedRun& run) {
  constexpr std::size_t kOutsideViews = 3;
  constexpr std::size_t kInsideViews = 4;
  constexpr int kWidth = 960;
  constexpr int kMostHeight = 720;
  Progress progress("drawing the map");
  MapPictures pictures(folder, surfels, errors, error_limit);
  const Points estimate = estimated_path(run, poses, placed);
  Points truth;
  for (const SE3& pose : run.truth.poses()) truth.push_back(pose.translation);
  // The truth is a white band with a rim, on which the estimate keeps to the middle.
  const std::vector<Line> lines = {
      {truth, {99, 85, 75}, 3}, {truth, {255, 255, 255}, 2}, {estimate, {12, 72, 232}, 1}};
  double done = 0;
  const auto report = [&] { progress.update(++done / (kOutsideViews + kInsideViews)); };
  for (const Viewpoint& view :
       outside_views(surfels, estimate, kOutsideViews, kWidth, kMostHeight)) {
    pictures.draw_outside(view, lines);
    report();
  }
  std::vector<std::pair<const ShownFrame*, SE3>> inside;
  for (const ShownFrame& frame : frames) {
    if (!frame.grid) continue;
    if (const auto pose = camera_pose(run, poses, placed, frame.utime))
      inside.emplace_back(&frame, *pose);
  }
  const std::size_t shown = std::min(inside.size(), kInsideViews);
  for (std::size_t i = 0; i < shown; ++i) {
    const auto& [frame, pose] = inside[(2 * i + 1) * inside.size() / (2 * shown)];
    const auto since_start = static_cast<double>(frame->utime - run.frame_utimes.front());
    pictures.draw_inside(*frame, since_start * 1e-6, pose);
    report();
  }
  pictures.write_index();
}

}  // namespace

void evaluate_map(Metrics& metrics, const std::string& log, const std::string& folder,
                  const std::string& surface, const std::string& pairs,
                  std::span<const ShownFrame> frames, RecordedRun& run) {
  const MapRecord& map = run.map;
  set_deformation_metrics(metrics, map.deformations);
  if (!map.deformations.empty()) {
    write_deformations(folder + "/deformations.csv", map.deformations);
  }
  if (map.sizes.empty()) return;
  metrics.set_count("map.messages", map.sizes.size());
  metrics.set_count("map.surfels", map.surfels.size());
  metrics.set_count("map.refused", map.refused);
  if (map.refused > 0) {
    run.notes.push_back(std::to_string(map.refused) +
                        " surfels of MAP_SURFELS are none (id, place, normal or radius make no "
                        "sense) and were left out");
  }
  const Points all = positions(map.surfels);
  std::vector<Surfel> stable_surfels;
  for (const Surfel& surfel : map.surfels) {
    if (is_stable(surfel, map.stable_confidence)) stable_surfels.push_back(surfel);
  }
  const Points stable = positions(stable_surfels);
  metrics.set_count("map.stable", stable.size());
  write_sizes(folder + "/map_size.csv", map.sizes);
  write_surfels(folder + "/map.ply", map.surfels, "map frame");
  if (all.empty()) {
    run.notes.push_back("the map ends empty: it is neither measured nor drawn");
    return;
  }
  std::optional<TrueSurface> true_surface;
  if (!surface.empty()) true_surface.emplace(read_surface(surface));
  const PoseChannel poses = poses_in_map(run);
  const Placed placed = place_map(run, poses, stable.empty() ? all : stable,
                                  true_surface ? &*true_surface : nullptr, pairs);
  std::vector<Surfel> shown = moved(map.surfels, placed.rig_T_map);
  std::vector<float> errors;
  double limit = 0;
  if (true_surface) {
    const std::vector<double> distances =
        set_surface_metrics(metrics, folder, *true_surface, placed, stable, all, run);
    errors.assign(distances.begin(), distances.end());
    constexpr double kLeastLimit = 1e-6;  // metres
    limit = round_limit(std::max(quantile(distances, 0.95), kLeastLimit));
    write_error_file(folder + "/map_error.ply", shown, errors, limit);
  }
  set_seen_metrics(metrics, log, placed, stable_surfels, run);
  set_thickness_metrics(
      metrics, stable_surfels,
      run.configuration.value_or(RigConfiguration{}).visual_slam.working_distance);
  // Pictures of what is stable, unless that is too little to look at.
  const bool only_stable = 2 * stable.size() >= all.size();
  metrics.set("map.drawn", only_stable ? "stable" : "all");
  if (only_stable) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < shown.size(); ++i) {
      if (!is_stable(shown[i], map.stable_confidence)) continue;
      shown[kept] = shown[i];
      if (!errors.empty()) errors[kept] = errors[i];
      ++kept;
    }
    shown.resize(kept);
    errors.resize(errors.empty() ? 0 : kept);
  }
  brighten(shown);
  draw_map(folder, shown, errors, limit, placed, poses, frames, run);
}

}  // namespace gastronaut::evaluation
