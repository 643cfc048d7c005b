// visual_slam over one recording, from many start frames, forwards and backwards, beside OpenCV's
// RgbdICPOdometry on the same frames.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <span>

#include "bench/visual_slam/opencv_odometry.hpp"
#include "bench/visual_slam/recorded_frames.hpp"
#include "bench/visual_slam/trial_report.hpp"
#include "bench/visual_slam/trial_scores.hpp"
#include "evaluate/pictures.hpp"
#include "numerics/parallel.hpp"
#include "process/command_line.hpp"
#include "process/progress.hpp"
#include "visual_slam/visual_slam.hpp"

namespace gastronaut::slam {
namespace {

enum class Direction { kBoth, kForwards, kBackwards };

struct Options {
  RecordingOptions recording;
  ColourChannel colour = ColourChannel::kAlbedo;
  std::size_t starts = 1;
  std::size_t least = 50;
  Direction direction = Direction::kBoth;
  std::string rpe_path = "5mm";
  std::string rpe_angle = "5deg";
  bool peer = false;
  int peer_width = 0;
  int threads = 0;
  std::string csv;
};

using Clock = std::chrono::steady_clock;
double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

// Where runs start in a sequence of that many frames, in either direction: the first leaves out
// nothing, the last has `least` frames before it.
std::vector<std::size_t> start_frames(std::size_t frames, const Options& options) {
  const std::size_t last = frames > options.least ? frames - options.least : 0;
  std::vector<std::size_t> starts;
  for (std::size_t i = 0; i < options.starts; ++i) {
    const std::size_t start = options.starts > 1 ? i * last / (options.starts - 1) : 0;
    if (starts.empty() || start > starts.back()) starts.push_back(start);
  }
  return starts;
}

struct Run {
  std::size_t start = 0;  // frames left out in the run's direction
  bool backwards = false;
};

std::vector<Run> planned_runs(std::size_t frames, const Options& options) {
  std::vector<Run> runs;
  for (const bool backwards : {false, true}) {
    if (options.direction == (backwards ? Direction::kForwards : Direction::kBackwards)) continue;
    for (const std::size_t start : start_frames(frames, options))
      runs.push_back({start, backwards});
  }
  return runs;
}

// The recording as a run sees it: time mirrored when it goes backwards.
class Sequence {
 public:
  Sequence(const Recording& recording, bool backwards)
      : frames_(recording.frames), backwards_(backwards) {}

  std::size_t size() const { return frames_.size(); }
  std::size_t number(std::size_t i) const { return backwards_ ? size() - 1 - i : i; }
  std::int64_t utime(std::size_t i) const {
    const std::int64_t utime = frames_[number(i)].utime;
    return backwards_ ? frames_.front().utime + (frames_.back().utime - utime) : utime;
  }

 private:
  std::span<const RecordedFrame> frames_;
  bool backwards_;
};

Trial empty_trial(const std::string& method, const Sequence& sequence, const Run& run) {
  return {method, sequence.number(run.start), run.backwards, {}};
}

TrialStatus status_of(SlamStatus status) {
  if (status == SlamStatus::kLost) return TrialStatus::kLost;
  return status == SlamStatus::kDegraded ? TrialStatus::kDegraded : TrialStatus::kOk;
}

VisualSlamOptions slam_options(const VisualSlamConfiguration& configuration) {
  VisualSlamOptions options;
  options.tracker.rgb_weight = configuration.rgb_weight;
  options.map.working_distance = configuration.working_distance;
  options.map.stable_confidence = configuration.stable_confidence;
  return options;
}

Trial run_visual_slam(const Recording& recording, std::vector<Frame>& frames, const Run& run) {
  const Sequence sequence(recording, run.backwards);
  Trial trial = empty_trial("visual_slam", sequence, run);
  VisualSlam slam(slam_options(recording.configuration.visual_slam));
  for (std::size_t i = run.start; i < sequence.size(); ++i) {
    const std::size_t number = sequence.number(i);
    Frame& frame = frames[number];
    frame.utime = sequence.utime(i);
    Estimate estimate;
    const auto start = Clock::now();
    const SlamPose pose = slam.track(frame, recording.frames[number].health);
    const auto tracked = Clock::now();
    estimate.track_ms = std::chrono::duration<double, std::milli>(tracked - start).count();
    slam.merge();
    estimate.merge_ms = milliseconds_since(tracked);
    slam.take_increment();
    estimate.utime = frame.utime;
    estimate.status = status_of(pose.status);
    estimate.cause = pose.cause;
    estimate.map_T_camera = pose.map_T_camera;
    estimate.covariance = pose.covariance;
    estimate.depth_scale = pose.depth_scale;
    estimate.inlier_fraction = pose.inlier_fraction;
    estimate.rig_T_camera = recording.frames[number].rig_T_camera;
    trial.estimates.push_back(std::move(estimate));
  }
  return trial;
}

enum class PeerPicture { kLuminance, kEqualised, kAlbedo };

struct PeerVariant {
  std::string name;
  PeerPicture picture;
};

std::vector<PeerVariant> peer_variants(const Recording& recording) {
  std::vector<PeerVariant> variants;
  if (recording.has_luminance) {
    variants.push_back({"opencv luminance", PeerPicture::kLuminance});
    variants.push_back({"opencv equalised", PeerPicture::kEqualised});
  }
  if (recording.has_albedo) variants.push_back({"opencv albedo", PeerPicture::kAlbedo});
  return variants;
}

AlbedoLevels peer_levels(const RecordedFrame& frame, PeerPicture picture) {
  AlbedoLevels levels = frame.colour(picture == PeerPicture::kAlbedo ? ColourChannel::kAlbedo
                                                                     : ColourChannel::kLuminance);
  if (picture == PeerPicture::kEqualised) {
    evaluation::Levels plane;
    plane.width = levels.grid.width;
    plane.height = levels.grid.height;
    plane.values = std::move(levels.levels);
    levels.levels = evaluation::equalise_contrast(plane).values;
  }
  return levels;
}

std::vector<std::uint8_t> to_levels(const Plane<float>& albedo) {
  constexpr float kWhite = 255;
  std::vector<std::uint8_t> levels;
  levels.reserve(albedo.size());
  for (const float value : albedo.values) {
    levels.push_back(static_cast<std::uint8_t>(std::lround(std::max(0.0F, value) * kWhite)));
  }
  return levels;
}

// Odometry has no memory, so one pass over the sequence holds all runs of that direction.
Trial whole_odometry(const Recording& recording, const PeerVariant& variant, bool backwards,
                     const Options& options) {
  const Sequence sequence(recording, backwards);
  Trial trial = empty_trial(variant.name, sequence, {0, backwards});
  std::optional<OpencvOdometry> odometry;
  SE3 map_T_camera;
  SE3 motion;
  Progress progress(variant.name + (backwards ? ", backwards" : ", forwards"));
  for (std::size_t i = 0; i < sequence.size(); ++i) {
    const RecordedFrame& recorded = recording.frames[sequence.number(i)];
    const int width = options.peer_width > 0 ? options.peer_width : recorded.depth.grid.width;
    const Frame frame = assemble_frame(sequence.utime(i), recorded.depth,
                                       peer_levels(recorded, variant.picture), width);
    const std::vector<std::uint8_t> levels = to_levels(frame.albedo);
    if (!odometry) {
      odometry.emplace(frame.grid, recording.configuration.visual_slam.working_distance,
                       SurfelMapOptions{}.farthest);
    }
    Estimate estimate;
    const auto start = Clock::now();
    const std::optional<SE3> tracked = odometry->track(frame.depth, levels);
    estimate.track_ms = milliseconds_since(start);
    estimate.utime = frame.utime;
    estimate.status = tracked || i == 0 ? TrialStatus::kOk : TrialStatus::kLost;
    if (i > 0) {
      if (tracked) motion = *tracked;  // else it goes on as it went
      map_T_camera = map_T_camera * motion;
    }
    estimate.map_T_camera = map_T_camera;
    estimate.rig_T_camera = recorded.rig_T_camera;
    trial.estimates.push_back(std::move(estimate));
    progress.update(static_cast<double>(i + 1) / static_cast<double>(sequence.size()));
  }
  return trial;
}

std::vector<Trial> run_peer(const Recording& recording, const PeerVariant& variant,
                            const Options& options) {
  std::map<bool, Trial> whole;  // by backwards
  std::vector<Trial> trials;
  for (const Run& run : planned_runs(recording.frames.size(), options)) {
    if (!whole.contains(run.backwards)) {
      whole[run.backwards] = whole_odometry(recording, variant, run.backwards, options);
    }
    const Sequence sequence(recording, run.backwards);
    Trial trial = empty_trial(variant.name, sequence, run);
    const auto& estimates = whole[run.backwards].estimates;
    trial.estimates.assign(estimates.begin() + static_cast<std::ptrdiff_t>(run.start),
                           estimates.end());
    trial.estimates.front().status = TrialStatus::kOk;
    trials.push_back(std::move(trial));
  }
  return trials;
}

std::vector<Frame> assemble_frames(const Recording& recording, ColourChannel colour) {
  std::vector<Frame> frames;
  std::vector<double> milliseconds;
  for (const RecordedFrame& recorded : recording.frames) {
    const auto start = Clock::now();
    frames.push_back(assemble_frame(recorded.utime, recorded.depth, recorded.colour(colour),
                                    recording.configuration.visual_slam.max_width));
    milliseconds.push_back(milliseconds_since(start));
  }
  fmt::print("{} frames of {} x {}, made of depth {} x {} in {:.1f} ms (median)\n", frames.size(),
             frames.front().grid.width, frames.front().grid.height,
             recording.frames.front().depth.grid.width, recording.frames.front().depth.grid.height,
             evaluation::quantile(milliseconds, 0.5));
  return frames;
}

int run_trials(const Options& options) {
  set_thread_count(options.threads);
  const Recording recording = read_recording(options.recording);
  const bool own_depth = options.recording.depth == DepthChannel::kOwn;
  const ColourChannel colour =
      recording.has_albedo && (options.colour == ColourChannel::kAlbedo || !recording.has_luminance)
          ? ColourChannel::kAlbedo
          : ColourChannel::kLuminance;
  ScoreOptions scoring;
  scoring.working_distance = recording.configuration.visual_slam.working_distance;
  scoring.path = evaluation::parse_delta(options.rpe_path);
  scoring.angle = evaluation::parse_delta(options.rpe_angle);
  scoring.alignment =
      own_depth ? evaluation::AlignmentKind::kSim3 : evaluation::AlignmentKind::kSe3;
  fmt::print("{}\n{} depth, {}\n", options.recording.log, own_depth ? "own" : "true",
             colour == ColourChannel::kAlbedo ? "albedo" : "luminance");
  FrameTable table(options.csv);
  const auto show = [&](std::vector<ScoredTrial>& shown, Trial&& trial) {
    ScoredTrial scored{std::move(trial), {}};
    scored.scores = score(scored.trial, scoring);
    print_row(scored);
    table.add(scored);
    shown.push_back(std::move(scored));
  };
  std::vector<std::vector<ScoredTrial>> methods(1);
  std::vector<Frame> frames = assemble_frames(recording, colour);
  print_header("visual_slam", options.rpe_path, options.rpe_angle);
  for (const Run& run : planned_runs(recording.frames.size(), options)) {
    show(methods.back(), run_visual_slam(recording, frames, run));
  }
  print_distribution(methods.back());
  if (options.peer) {
    for (const PeerVariant& variant : peer_variants(recording)) {
      print_header(variant.name, options.rpe_path, options.rpe_angle);
      methods.emplace_back();
      for (Trial& trial : run_peer(recording, variant, options)) {
        show(methods.back(), std::move(trial));
      }
      print_distribution(methods.back());
    }
  }
  print_comparison(methods);
  return kExitDone;
}

void add_options(CLI::App& app, Options& options) {
  RecordingOptions& recording = options.recording;
  app.add_option("log", recording.log, "derived log with pictures and true poses")
      ->required()
      ->check(CLI::ExistingFile);
  add_configuration_options(app, recording.configuration_files, recording.settings);
  app.add_option("--depth", recording.depth, "own (default): DEPTH; truth: GROUND_TRUTH_DEPTH")
      ->transform(CLI::CheckedTransformer(std::map<std::string, DepthChannel>{
          {"own", DepthChannel::kOwn}, {"truth", DepthChannel::kTruth}}));
  app.add_option("--truth-std", recording.truth_relative_std,
                 "what true depth is said to be uncertain by, as a fraction")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  app.add_option("--colour", options.colour,
                 "albedo (default): ALBEDO, where the log has it; luminance: CAMERA")
      ->transform(CLI::CheckedTransformer(std::map<std::string, ColourChannel>{
          {"albedo", ColourChannel::kAlbedo}, {"luminance", ColourChannel::kLuminance}}));
  app.add_option("--starts", options.starts, "start frames, spread evenly; the first one is 0")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  app.add_option("--least", options.least, "frames in the shortest run")->capture_default_str();
  app.add_option("--direction", options.direction, "both (default), forwards or backwards")
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, Direction>{{"both", Direction::kBoth},
                                           {"forwards", Direction::kForwards},
                                           {"backwards", Direction::kBackwards}}));
  app.add_option("--rpe-path", options.rpe_path, "length of relative position errors")
      ->capture_default_str();
  app.add_option("--rpe-angle", options.rpe_angle, "length of relative rotation errors")
      ->capture_default_str();
  app.add_flag("--peer", options.peer, "OpenCV's RgbdICPOdometry as well");
  app.add_option("--peer-width", options.peer_width,
                 "pixels of its frames, at most (default: all that depth has)");
  app.add_option("--threads", options.threads, "0: one a core")->capture_default_str();
  app.add_option("--csv", options.csv, "write one row a frame into this file");
}

}  // namespace
}  // namespace gastronaut::slam

int main(int argc, char** argv) {
  gastronaut::slam::Options options;
  CLI::App app(
      "Runs visual_slam over a recording, from many start frames, forwards and backwards, and "
      "says\n"
      "how far it is from the true poses in it; with --peer beside OpenCV's RgbdICPOdometry.\n\n"
      "Example: slam_trials derived.lcmlog --starts 12 --peer\n"
      "where derived.lcmlog was written by: replay raw.lcmlog --out derived.lcmlog "
      "--keep-images\n\n"
      "silent: no, or !N, N being the frames reported as tracked that are 0.06 working distances\n"
      "from where they belong by the poses before them; !0: nothing reported, yet the run's error\n"
      "is over 0.02 working distances. With own depth this is after Sim(3), else after SE(3).",
      "slam_trials");
  gastronaut::slam::add_options(app, options);
  return gastronaut::run_command_line(app, argc, argv,
                                      [&] { return gastronaut::slam::run_trials(options); });
}
