#include "import/import_program.hpp"

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>

#include "import/capture_folder.hpp"
#include "import/import_process.hpp"
#include "import/tum_folder.hpp"
#include "import/video_recording.hpp"
#include "process/command_line.hpp"

namespace gastronaut {
namespace {

constexpr double kDefaultEpoch = 1'700'000'000;  // seconds; fixed, so that bytes repeat
// Structured-light and time-of-flight cameras at a few metres.
constexpr double kDefaultDepthRelativeStd = 0.01;

struct Options {
  std::string source;
  std::string out;
  std::string camera;
  ConfigurationOverrides overrides;
  double epoch = kDefaultEpoch;
  double depth_relative_std = kDefaultDepthRelativeStd;
  VideoFiles video;
};

// The configuration of recordings that bring none of their own.
RigConfiguration load_configuration(const Options& options, double metres_per_depth_count) {
  RigConfiguration rig;
  rig.camera.metres_per_depth_count = metres_per_depth_count;
  std::vector<YamlSource> sources = {load_yaml_file(options.camera)};
  for (const std::string& file : options.overrides.files) sources.push_back(load_yaml_file(file));
  read_configuration(rig, sources, options.overrides.settings);
  return rig;
}

void add_common(CLI::App& command, Options& options) {
  command.add_option("--out", options.out, "log to write")->required();
  command
      .add_option("--rig", options.overrides.files,
                  "YAML file with further parts of the rig's configuration; repeatable")
      ->allow_extra_args(false)
      ->check(CLI::ExistingFile);
  command
      .add_option("--set", options.overrides.settings,
                  "override one value, e.g. --set camera.rate=30")
      ->allow_extra_args(false);
}

void add_camera(CLI::App& command, Options& options) {
  command.add_option("--camera", options.camera, "YAML file with the camera: section")
      ->required()
      ->check(CLI::ExistingFile);
  command
      .add_option("--depth-relative-std", options.depth_relative_std,
                  "one sigma of the sensor's depth, as a fraction of it")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
}

void add_video(CLI::App& command, VideoFiles& files) {
  command.add_option("pictures", files.pictures, "video file or folder")->required();
  command.add_option("--depth", files.depth,
                     "folder of 16-bit depth pictures with the pictures' numbers");
  command.add_option("--hall", files.hall,
                     "CSV: seconds from the first frame, then the Hall channels in tesla");
  command.add_option("--coils", files.coils,
                     "CSV: seconds from the first frame, then the coils' currents in ampere");
  command.add_option("--poses", files.poses,
                     "true camera poses: TUM (seconds from the first frame), KITTI or Open3D .log");
  command.add_option("--rate", files.rate, "frames a second, instead of the video's own")
      ->check(CLI::PositiveNumber);
}

int write(Recording recording, const std::string& out, Issues& issues) {
  for (const auto& [channel, count] : write_recording(std::move(recording), out, issues)) {
    spdlog::info("{}: {} messages", channel, count);
  }
  if (issues.count() > 0) spdlog::warn("{} rows or pictures were left out", issues.count());
  spdlog::info("wrote {}", out);
  return kExitDone;
}

}  // namespace

int run_import(int argc, char** argv) {
  Options options;
  CLI::App app("Turns recordings into LCM logs with RIG_CONFIG.", "import");
  app.require_subcommand(1);
  CLI::App* capture = app.add_subcommand("capture", "a capture folder with calib.yaml");
  CLI::App* tum = app.add_subcommand("tum", "a TUM RGB-D folder");
  CLI::App* video = app.add_subcommand("video", "a video or a folder of numbered pictures");
  for (CLI::App* command : {capture, tum, video}) add_common(*command, options);
  for (CLI::App* command : {tum, video}) add_camera(*command, options);
  for (CLI::App* command : {capture, tum}) {
    command->add_option("folder", options.source)->required();
  }
  for (CLI::App* command : {capture, video}) {
    command->add_option("--epoch", options.epoch, "utime of the start, seconds since 1970")
        ->capture_default_str();
  }
  add_video(*video, options.video);

  return run_command_line(app, argc, argv, [&] {
    Issues issues([](const std::string& what, std::size_t count) {
      constexpr std::size_t kMostNamed = 100;
      if (count <= kMostNamed) spdlog::warn("{}", what);
      if (count == kMostNamed) spdlog::warn("whatever else is left out is only counted");
    });
    if (capture->parsed()) {
      return write(open_capture_folder(options.source, options.overrides, options.epoch, issues),
                   options.out, issues);
    }
    if (tum->parsed()) {
      constexpr double kBenchmarkCount = 1.0 / 5000;  // metres
      return write(open_tum_folder(options.source, load_configuration(options, kBenchmarkCount),
                                   options.depth_relative_std, issues),
                   options.out, issues);
    }
    options.video.depth_relative_std = options.depth_relative_std;
    const RigConfiguration rig =
        load_configuration(options, RigConfiguration{}.camera.metres_per_depth_count);
    return write(open_video_recording(options.video, rig, options.epoch, issues), options.out,
                 issues);
  });
}

}  // namespace gastronaut
