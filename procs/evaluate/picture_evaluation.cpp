#include "evaluate/picture_evaluation.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "evaluate/frame_views.hpp"
#include "evaluate/picture_process.hpp"
#include "evaluate/point_constancy.hpp"
#include "process/channels.hpp"
#include "process/progress.hpp"

namespace gastronaut::evaluation {
namespace {

// Points are looked up in frames at least this far apart: more would cost time and tell no more.
constexpr std::int64_t kLookupPeriod = 95000;  // microseconds, 0.1 s less jitter

struct Band {
  const char* name;
  double near;  // metres, true depth
  double far;
};
constexpr std::array<Band, 5> kBands = {
    {{"5_to_15mm", 0.005, 0.015},
     {"15_to_30mm", 0.015, 0.030},
     {"30_to_45mm", 0.030, 0.045},
     {"45_to_70mm", 0.045, 0.070},
     {"over_70mm", 0.070, std::numeric_limits<double>::infinity()}}};

void set_errors(Metrics& metrics, const std::string& key, const ErrorSums& errors) {
  metrics.set(key + ".mean_abs", errors.mean_absolute());
  metrics.set(key + ".rmse", errors.rmse());
  metrics.set(key + ".relative", errors.mean_relative());
  metrics.set(key + ".bias", errors.bias());
}

class PictureEvaluation {
 public:
  PictureEvaluation(const std::string& folder, const std::vector<std::size_t>& frames,
                    RecordedRun& run)
      : run_(run),
        shown_(choose_frames(run.frame_utimes.size(), frames, run.notes)),
        views_(folder) {
    if (has(channel::kAlbedo)) kinds_.push_back("albedo");
    if (has(channel::kCamera) && run.configuration) {
      kinds_.push_back("luminance");
      kinds_.push_back("clahe");
    }
    constancy_.emplace(kinds_.size());
    const bool comparable = !kinds_.empty() && has(channel::kGroundTruthDepth);
    for (std::size_t i = 0; i < run.frame_utimes.size(); ++i) {
      const std::int64_t utime = run.frame_utimes[i];
      const bool due = followed_.empty() || utime - followed_.back() >= kLookupPeriod;
      if (comparable && due && run.truth.at(utime)) followed_.push_back(utime);
      if (std::binary_search(shown_.begin(), shown_.end(), i)) utimes_.push_back(utime);
    }
    utimes_.insert(utimes_.end(), followed_.begin(), followed_.end());
    std::sort(utimes_.begin(), utimes_.end());
    utimes_.erase(std::unique(utimes_.begin(), utimes_.end()), utimes_.end());
  }

  // Of the frames that are needed, ascending.
  const std::vector<std::int64_t>& utimes() const { return utimes_; }
  PictureProblems& problems() { return problems_; }
  const std::vector<ShownFrame>& shown() const { return shown_frames_; }

  void use(const Frame& frame) {
    const std::optional<PinholeGrid> grid = picture_grid(frame);
    const std::optional<ColourPicture> input = undistort(frame, grid);
    const auto place =
        std::lower_bound(run_.frame_utimes.begin(), run_.frame_utimes.end(), frame.utime);
    const auto number = static_cast<std::size_t>(place - run_.frame_utimes.begin());
    if (std::binary_search(shown_.begin(), shown_.end(), number)) {
      const std::int64_t start = run_.frame_utimes.front();
      shown_frames_.push_back({number, frame.utime, grid});
      views_.write(number, static_cast<double>(frame.utime - start) * 1e-6, frame, input);
    }
    if (grid && std::binary_search(followed_.begin(), followed_.end(), frame.utime)) {
      follow(frame, *grid, input);
    }
  }

  void finish(Metrics& metrics) {
    views_.write_index();
    metrics.set_count("frames.count", run_.frame_utimes.size());
    metrics.set_count("frames.shown", shown_.size());
    constancy_->finish();
    if (constancy_->points() > 0) {
      metrics.set_count("constancy.points", constancy_->points());
      metrics.set_count("constancy.references", constancy_->references());
      metrics.set("constancy.distance_ratio", constancy_->distance_ratio());
      const std::vector<Constancy> constancies = constancy_->constancies();
      for (std::size_t kind = 0; kind < kinds_.size(); ++kind) {
        const Constancy& of_kind = constancies[kind];
        metrics.set(kinds_[kind] + ".spread", of_kind.spread);
        if (!(of_kind.contrast > 0)) continue;
        metrics.set(kinds_[kind] + ".contrast", of_kind.contrast);
        metrics.set(kinds_[kind] + ".spread_over_contrast", of_kind.spread / of_kind.contrast);
        if (!(of_kind.local_contrast > 0)) continue;
        metrics.set(kinds_[kind] + ".local_contrast", of_kind.local_contrast);
        metrics.set(kinds_[kind] + ".spread_over_local_contrast",
                    of_kind.spread / of_kind.local_contrast);
      }
    } else if (has(channel::kAlbedo) && !followed_.empty()) {
      run_.notes.push_back(
          "no surface point could be followed through the pictures: nothing is "
          "said about the constancy of ALBEDO");
    }
    if (has(channel::kAlbedo) && !has(channel::kCamera)) {
      run_.notes.push_back(
          "there is no CAMERA in the log (replay --keep-images carries it along): "
          "ALBEDO is not compared with the picture that it was made from");
    }
    for (const auto& [problem, count] : problems_) {
      run_.notes.push_back(problem + " (" + std::to_string(count) + " of the " +
                           std::to_string(utimes_.size()) + " frames that were looked at)");
    }
  }

 private:
  bool has(const char* name) const { return run_.channels.contains(name); }

  // The pixels that ALBEDO has, or would have.
  std::optional<PinholeGrid> picture_grid(const Frame& frame) {
    if (frame.depth && frame.albedo) {
      const auto grid = finer_grid(*frame.depth, frame.albedo->width, frame.albedo->height);
      if (!grid) ++problems_["ALBEDO: its size is no whole multiple of DEPTH's"];
      return grid;
    }
    if (!run_.configuration) return std::nullopt;
    const CameraConfiguration& camera = run_.configuration->camera;
    return PinholeGrid{camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy};
  }

  std::optional<ColourPicture> undistort(const Frame& frame,
                                         const std::optional<PinholeGrid>& grid) {
    if (!frame.camera || !grid || !run_.configuration) return std::nullopt;
    const CameraConfiguration& camera = run_.configuration->camera;
    if (!frame.camera->same_size(camera.width, camera.height)) {
      ++problems_["CAMERA: the picture has another size than the configuration says"];
      return std::nullopt;
    }
    if (!undistorter_ || undistorter_->grid() != *grid) {
      undistorter_.emplace(camera.intrinsics(), *grid);
    }
    return undistorter_->undistort(*frame.camera);
  }

  void follow(const Frame& frame, const PinholeGrid& grid,
              const std::optional<ColourPicture>& input) {
    if (!frame.truth) return;
    std::vector<Levels> pictures;
    if (frame.albedo && frame.albedo->same_size(grid.width, grid.height)) {
      pictures.push_back(*frame.albedo);
    }
    if (input) {
      pictures.push_back(luminance(*input));
      pictures.push_back(equalise_contrast(pictures.back()));
    }
    // The kinds are compared on the same points.
    if (pictures.size() != kinds_.size()) return;
    constancy_->add({frame.utime, *run_.truth.at(frame.utime), *frame.truth, grid, pictures});
  }

  RecordedRun& run_;
  std::vector<std::size_t> shown_;      // numbers, ascending
  std::vector<std::int64_t> followed_;  // utimes, ascending
  std::vector<std::int64_t> utimes_;    // of both
  std::vector<std::string> kinds_;
  FrameViews views_;
  std::vector<ShownFrame> shown_frames_;
  std::optional<PointConstancy> constancy_;
  std::optional<Undistorter> undistorter_;
  PictureProblems problems_;
};

}  // namespace

void set_depth_metrics(Metrics& metrics, const DepthSeries& depth) {
  if (depth.frames.empty()) return;
  DepthErrors total;
  std::vector<double> scales;
  for (const DepthFrame& frame : depth.frames) {
    total += frame.errors;
    if (frame.errors.compared.count > 0) scales.push_back(frame.errors.scale);
  }
  metrics.set_count("DEPTH.count", depth.frames.size());
  if (total.truth_pixels > 0) metrics.set("DEPTH.coverage", total.coverage());
  if (total.compared.count == 0) return;
  set_errors(metrics, "DEPTH", total.compared);
  metrics.set("DEPTH.mean_abs_scaled", total.mean_absolute_scaled());
  metrics.set_statistics("DEPTH.scale", scales);
  if (total.normalised_pixels > 0) {
    metrics.set("DEPTH.normalised_error", total.normalised_error());
  }
  for (const Band& band : kBands) {
    const DepthProfile::Bin bin = depth.profile.between(band.near, band.far);
    const std::string key = std::string("DEPTH.") + band.name;
    metrics.set_count(key + ".count", bin.compared.count);
    if (bin.truth_pixels == 0) continue;
    metrics.set(key + ".coverage",
                static_cast<double>(bin.compared.count) / static_cast<double>(bin.truth_pixels));
    if (bin.compared.count > 0) set_errors(metrics, key, bin.compared);
  }
}

std::vector<ShownFrame> evaluate_pictures(Metrics& metrics, const std::string& log,
                                          const std::string& folder,
                                          const std::vector<std::size_t>& frames,
                                          RecordedRun& run) {
  if (run.frame_utimes.empty()) {
    if (!frames.empty()) run.notes.push_back("there are no pictures in the log to show");
    return {};
  }
  PictureEvaluation evaluation(folder, frames, run);
  Progress progress("looking at the pictures of " + log);
  read_frames(
      log, evaluation.utimes(), evaluation.problems(),
      [&evaluation](const Frame& frame) { evaluation.use(frame); },
      [&progress](double fraction) { progress.update(fraction); });
  evaluation.finish(metrics);
  return evaluation.shown();
}

}  // namespace gastronaut::evaluation
