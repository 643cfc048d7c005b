#include "bench/visual_slam/trial_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <stdexcept>

namespace gastronaut::slam {
namespace {

constexpr double kMillimetre = 1e-3;
constexpr double kDegree = std::numbers::pi / 180;

std::string shown(double value, int width, int decimals) {
  return std::isnan(value) ? fmt::format("{:>{}}", "-", width)
                           : fmt::format("{:{}.{}f}", value, width, decimals);
}

struct Figure {
  const char* name;
  double (*of)(const TrialScores&);
};

constexpr Figure kSe3 = {"ATE SE(3) mm",
                         [](const TrialScores& s) { return s.ate_se3 / kMillimetre; }};
constexpr Figure kSim3 = {"ATE Sim(3) mm",
                          [](const TrialScores& s) { return s.ate_sim3 / kMillimetre; }};
constexpr Figure kScale = {"|scale - 1| %",
                           [](const TrialScores& s) { return 100 * std::abs(s.scale - 1); }};
constexpr Figure kPath = {"RPE path mm",
                          [](const TrialScores& s) { return s.rpe_path / kMillimetre; }};
constexpr Figure kAngle = {"RPE angle deg",
                           [](const TrialScores& s) { return s.rpe_angle / kDegree; }};
constexpr Figure kDrift = {"drift %", [](const TrialScores& s) { return 100 * s.drift; }};
constexpr Figure kNees = {"NEES mean", [](const TrialScores& s) { return s.nees_mean; }};
constexpr Figure kLost = {"lost frames",
                          [](const TrialScores& s) { return static_cast<double>(s.lost); }};
constexpr Figure kDegraded = {"degraded frames",
                              [](const TrialScores& s) { return static_cast<double>(s.degraded); }};
constexpr Figure kTrack = {"track ms median",
                           [](const TrialScores& s) { return s.track_ms_median; }};
constexpr Figure kMerge = {"merge ms median",
                           [](const TrialScores& s) { return s.merge_ms_median; }};

double over_runs(std::span<const ScoredTrial> trials, const Figure& figure, double fraction) {
  std::vector<double> values;
  for (const ScoredTrial& trial : trials) {
    const double value = figure.of(trial.scores);
    if (!std::isnan(value)) values.push_back(value);
  }
  return evaluation::quantile(values, fraction);
}

double sum(std::span<const ScoredTrial> trials, const Figure& figure) {
  double total = 0;
  for (const ScoredTrial& trial : trials) total += figure.of(trial.scores);
  return total;
}

std::ptrdiff_t count_silent(std::span<const ScoredTrial> trials) {
  return std::count_if(trials.begin(), trials.end(),
                       [](const ScoredTrial& t) { return t.scores.failed_silently; });
}

std::string pose_columns(const std::optional<SE3>& transform) {
  if (!transform) return ",,,,,,";
  const auto& p = transform->translation;
  const auto& q = transform->rotation;
  return fmt::format("{},{},{},{},{},{},{}", p.x(), p.y(), p.z(), q.w(), q.x(), q.y(), q.z());
}

std::string column(const std::optional<double>& value) {
  return value ? fmt::format("{}", *value) : "";
}

std::string sigma_columns(const Estimate& estimate) {
  if (!estimate.covariance) return ",";
  return fmt::format("{},{}", std::sqrt(estimate.covariance->topLeftCorner<3, 3>().trace()),
                     std::sqrt(estimate.covariance->bottomRightCorner<3, 3>().trace()));
}

const char* name_of(TrialStatus status) {
  static constexpr std::array<const char*, 3> kNames = {"OK", "DEGRADED", "LOST"};
  return kNames[static_cast<std::size_t>(status)];
}

}  // namespace

void print_header(const std::string& method, const std::string& rpe_path,
                  const std::string& rpe_angle) {
  fmt::print("\n{}\n", method);
  fmt::print(
      "start dir  frames  path mm | ATE mm SE3    Sim3   scale | RPE mm {:>5}  deg {:>5} | drift % "
      "| lost degr silent | NEES mean  median | track ms    p99 | merge ms    p99\n",
      rpe_path, rpe_angle);
}

void print_row(const ScoredTrial& scored) {
  const TrialScores& s = scored.scores;
  fmt::print("{:5} {} {:7} {} | {} {} {} | {} {} | {} | {:4} {:4} {:>6} | {} {} | {} {} | {} {}\n",
             scored.trial.start, scored.trial.backwards ? "back" : "forw", s.frames,
             shown(s.path / kMillimetre, 8, 1), shown(s.ate_se3 / kMillimetre, 10, 3),
             shown(s.ate_sim3 / kMillimetre, 7, 3), shown(s.scale, 7, 4),
             shown(s.rpe_path / kMillimetre, 12, 3), shown(s.rpe_angle / kDegree, 10, 3),
             shown(100 * s.drift, 7, 2), s.lost, s.degraded,
             s.failed_silently ? fmt::format("!{}", s.silent_frames) : "no",
             shown(s.nees_mean, 9, 1), shown(s.nees_median, 7, 1), shown(s.track_ms_median, 8, 1),
             shown(s.track_ms_p99, 6, 1), shown(s.merge_ms_median, 8, 1),
             shown(s.merge_ms_p99, 6, 1));
  std::fflush(stdout);
}

void print_distribution(std::span<const ScoredTrial> trials) {
  fmt::print("{:16} {:>9} {:>9} {:>9} {:>9}   ({} runs, {} failed silently)\n", "", "min", "median",
             "90 %", "max", trials.size(), count_silent(trials));
  for (const Figure& figure :
       {kSe3, kSim3, kScale, kPath, kAngle, kDrift, kNees, kLost, kDegraded, kTrack, kMerge}) {
    fmt::print("{:16} {} {} {} {}\n", figure.name, shown(over_runs(trials, figure, 0), 9, 3),
               shown(over_runs(trials, figure, 0.5), 9, 3),
               shown(over_runs(trials, figure, 0.9), 9, 3),
               shown(over_runs(trials, figure, 1), 9, 3));
  }
  fmt::print("\n");
}

void print_comparison(std::span<const std::vector<ScoredTrial>> methods) {
  fmt::print(
      "{:18} {:>4} | {:>8} {:>7} {:>7} | {:>8} {:>7} | {:>7} | {:>8} {:>8} | {:>5} {:>5} {:>6} | "
      "{:>5} | {:>8} {:>8}\n",
      "all methods", "runs", "SE3 mm", "median", "worst", "Sim3 mm", "worst", "scale %", "path mm",
      "angle dg", "lost", "degr", "silent", "NEES", "track ms", "merge ms");
  for (const std::vector<ScoredTrial>& trials : methods) {
    const auto figure = [&](const Figure& of, double fraction, int width, int decimals) {
      return shown(over_runs(trials, of, fraction), width, decimals);
    };
    fmt::print("{:18} {:4} | {} {} {} | {} {} | {} | {} {} | {:5} {:5} {:6} | {} | {} {}\n",
               trials.front().trial.method, trials.size(),
               shown(kSe3.of(trials.front().scores), 8, 3), figure(kSe3, 0.5, 7, 3),
               figure(kSe3, 1, 7, 3), figure(kSim3, 0.5, 8, 3), figure(kSim3, 1, 7, 3),
               figure(kScale, 1, 7, 2), figure(kPath, 0.5, 8, 3), figure(kAngle, 0.5, 8, 3),
               sum(trials, kLost), sum(trials, kDegraded), count_silent(trials),
               figure(kNees, 0.5, 5, 1), figure(kTrack, 0.5, 8, 1), figure(kMerge, 0.5, 8, 1));
  }
}

FrameTable::FrameTable(const std::string& path) {
  if (path.empty()) return;
  file_.open(path);
  if (!file_) throw std::runtime_error("cannot write " + path);
  file_ << "method,start,backwards,frame,utime,status,cause,x,y,z,qw,qx,qy,qz,true_x,true_y,"
           "true_z,true_qw,true_qx,true_qy,true_qz,error_se3,error_sim3,error_from_before,nees,"
           "depth_scale,inlier_fraction,sigma_position,sigma_rotation,track_ms,merge_ms\n";
}

void FrameTable::add(const ScoredTrial& scored) {
  if (!file_.is_open()) return;
  const Trial& trial = scored.trial;
  for (std::size_t i = 0; i < trial.estimates.size(); ++i) {
    const Estimate& estimate = trial.estimates[i];
    const std::optional<FrameErrors>& errors = scored.scores.errors[i];
    const std::size_t frame = trial.backwards ? trial.start - i : trial.start + i;
    file_ << fmt::format("\"{}\",{},{},{},{},{},\"{}\",{},{},{},{},{},{},{},{},{},{}\n",
                         trial.method, trial.start, trial.backwards ? 1 : 0, frame, estimate.utime,
                         name_of(estimate.status), estimate.cause,
                         pose_columns(estimate.map_T_camera), pose_columns(estimate.rig_T_camera),
                         errors ? fmt::format("{},{}", errors->ate_se3, errors->ate_sim3) : ",",
                         column(errors ? errors->from_before : std::nullopt),
                         column(errors ? errors->nees : std::nullopt), estimate.depth_scale,
                         estimate.inlier_fraction, sigma_columns(estimate), estimate.track_ms,
                         column(estimate.merge_ms));
  }
  file_.flush();
  if (!file_) throw std::runtime_error("cannot write the table of frames");
}

}  // namespace gastronaut::slam
