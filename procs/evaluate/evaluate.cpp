#include "evaluate/evaluate.hpp"

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "configuration/fields.hpp"
#include "evaluate/log_evaluation.hpp"
#include "evaluate/report.hpp"
#include "evaluate/surface_placement.hpp"
#include "evaluate/trajectory_comparison.hpp"
#include "process/command_line.hpp"

namespace gastronaut {
namespace {

using evaluation::Metrics;

struct Options {
  std::string log;
  std::string out;
  std::string surface;
  std::string surface_pairs;
  std::vector<std::size_t> frames;
  std::vector<std::string> failures;
  bool open = false;
  evaluation::TrajectoryComparison comparison;
};

void make_folder(const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error || !std::filesystem::is_directory(folder)) {
    throw std::runtime_error(folder + " cannot be made a folder: " + error.message());
  }
}

// The figures that one looks at first.
void print_summary(const Metrics& metrics) {
  const auto ends_with_one_of = [](const std::string& key) {
    for (const char* end : {".with_truth",
                            ".availability",
                            ".ate.none.rmse",
                            ".ate.se3.rmse",
                            ".ate.sim3.rmse",
                            ".axis_error_deg.mean",
                            ".rotation_error_deg.mean",
                            ".nees.mean",
                            ".nees.band_low",
                            ".nees.band_high",
                            ".detection_delay",
                            ".recovery_delay",
                            ".ratio_to_nominal",
                            ".false_alarms.count",
                            ".jump",
                            ".cramer_rao.position_ratio",
                            ".cramer_rao.axis_ratio",
                            "DEPTH.mean_abs",
                            "DEPTH.mean_abs_scaled",
                            "DEPTH.30_to_45mm.mean_abs",
                            "DEPTH.bias",
                            "DEPTH.coverage",
                            "DEPTH.scale.mean",
                            "DEPTH.scale.std",
                            "DEPTH.normalised_error",
                            "map.surfels",
                            "map.stable",
                            "surface.none.mean",
                            "surface.trajectory.mean",
                            "surface.pairs.mean",
                            "surface.shape.mean",
                            "surface.all.mean",
                            "surface.handa.mean",
                            "surface.paper.mean",
                            "surface.seen.trajectory.mean",
                            "surface.thickness.mean",
                            "surface.thickness.share_double",
                            "surface.completeness.within_1.5mm",
                            "deformation.frame.count",
                            "deformation.local_loop.count",
                            "deformation.global_loop.count",
                            ".spread",
                            ".spread_over_contrast",
                            ".spread_over_local_contrast",
                            ".ms_per_event.median",
                            ".ms_per_event.p99"}) {
      if (key.ends_with(end)) return true;
    }
    return false;
  };
  for (const auto& [key, value] : metrics.list()) {
    if (key.starts_with("note.")) {
      spdlog::warn("{}", std::get<std::string>(value));
    } else if (ends_with_one_of(key)) {
      std::visit([&name = key](const auto& v) { fmt::print("{:<48} {}\n", name, v); }, value);
    }
  }
}

void open_report(const std::string& page) {
  setenv("GASTRONAUT_PAGE", page.c_str(), 1);  // not through the shell's quoting
  if (std::system("xdg-open \"$GASTRONAUT_PAGE\"") != 0) {
    spdlog::warn("no browser could be started; open {} yourself", page);
  }
}

int finish_report(const Options& options) {
  evaluation::draw_report(options.out, options.surface);
  const std::string page = options.out + "/index.html";
  fmt::print("report: {}\n", page);
  if (options.open) open_report(page);
  return kExitDone;
}

std::vector<evaluation::TrueFailure> true_failures(const Options& options) {
  std::vector<evaluation::TrueFailure> failures;
  try {
    for (const std::string& text : options.failures) {
      failures.push_back(evaluation::parse_failure(text));
    }
  } catch (const std::invalid_argument& error) {
    throw ConfigurationError(std::string("--failure: ") + error.what());
  }
  return failures;
}

// Before the long work.
void check_pairs(const Options& options) {
  if (options.surface_pairs.empty()) return;
  if (options.surface.empty()) {
    throw ConfigurationError("--surface-pairs places the map on a surface: give it by --surface");
  }
  try {
    evaluation::place_by_pairs(evaluation::read_pairs(options.surface_pairs));
  } catch (const std::exception& error) {
    throw ConfigurationError("--surface-pairs " + options.surface_pairs + ": " + error.what());
  }
}

int score_log(const Options& options) {
  const std::vector<evaluation::TrueFailure> failures = true_failures(options);
  check_pairs(options);
  make_folder(options.out);
  print_summary(evaluation::evaluate_log(options.log, options.out, options.frames, options.surface,
                                         failures, options.surface_pairs));
  return finish_report(options);
}

int score_trajectories(const Options& options) {
  evaluation::ComparedTrajectories compared;
  try {
    compared = evaluation::compare_trajectories(options.comparison);
  } catch (const std::invalid_argument& error) {
    throw ConfigurationError(error.what());
  }
  std::fputs(evaluation::describe(options.comparison, compared).c_str(), stdout);
  if (options.out.empty()) return kExitDone;
  make_folder(options.out);
  evaluation::write_comparison(options.comparison, compared, options.out);
  return finish_report(options);
}

}  // namespace

int run_evaluate(int argc, char** argv) {
  CLI::App app(
      "Scores the poses, pictures and map of a derived log against the ground truth in it, into\n"
      "a folder with index.html, metrics.json, trajectories, series and the map.\n\n"
      "Example: evaluate derived.lcmlog --out report/",
      "evaluate");
  Options options;
  app.add_option("log", options.log, "log that replay or a process wrote")
      ->check(CLI::ExistingFile);
  app.add_option("--out", options.out, "folder of the report, made where missing");
  app.add_option("--surface", options.surface,
                 "true surface (PLY, rig frame): the map is measured against it")
      ->check(CLI::ExistingFile);
  app.add_option("--surface-pairs", options.surface_pairs,
                 "CSV file of three or more picked pairs, map x,y,z and surface x,y,z in metres,\n"
                 "that place the map on --surface (default: its trajectory, else its shape)")
      ->check(CLI::ExistingFile);
  app.add_option("--frames", options.frames,
                 "numbers of the pictures to show, as in 0,100,200 (default: 6 over the log)")
      ->delimiter(',')
      ->allow_extra_args(false);
  app.add_option(
         "--failure", options.failures,
         "when a sensor was of no use in truth: SENSOR:START-END in seconds from the\n"
         "first pose (0 on the report's time axes), as in visual:7-13; once for each failure")
      ->allow_extra_args(false);
  app.add_flag("--open", options.open, "show the report in the browser");

  CLI::App* trajectories = app.add_subcommand(
      "trajectories", "scores one trajectory file against another and prints the statistics");
  evaluation::TrajectoryComparison& comparison = options.comparison;
  trajectories->add_option("estimate", comparison.estimate)->required()->check(CLI::ExistingFile);
  trajectories->add_option("ground_truth", comparison.truth)->required()->check(CLI::ExistingFile);
  trajectories->add_option("--format", comparison.format, "tum (default) or kitti")
      ->transform(CLI::CheckedTransformer(std::map<std::string, TrajectoryFormat>{
          {"tum", TrajectoryFormat::kTum}, {"kitti", TrajectoryFormat::kKitti}}));
  trajectories
      ->add_option("--max-difference", comparison.max_difference,
                   "seconds between poses that belong together")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  trajectories
      ->add_option("--rpe-delta", comparison.delta,
                   "distance of the pairs of relative errors: 5frames, 10m, 5mm, 1s, 5deg")
      ->capture_default_str();
  trajectories->add_flag("--all-pairs", comparison.all_pairs,
                         "a pair starts at every pose, not where the last one ended");
  trajectories->add_flag("--pairs-from-reference", comparison.pairs_along_truth,
                         "measure the delta along the true path");
  trajectories->add_option("--out", options.out, "write a report into this folder too");
  trajectories->add_flag("--open", options.open, "show the report in the browser");

  return run_command_line(app, argc, argv, [&] {
    if (trajectories->parsed()) return score_trajectories(options);
    if (options.log.empty() || options.out.empty()) {
      throw ConfigurationError("write: evaluate LOG --out FOLDER (see --help)");
    }
    return score_log(options);
  });
}

}  // namespace gastronaut
