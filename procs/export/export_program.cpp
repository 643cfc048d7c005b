#include "export/export_program.hpp"

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include "export/export_process.hpp"
#include "process/command_line.hpp"
#include "process/progress.hpp"

namespace gastronaut {
namespace {

struct Arguments {
  std::string log;
  std::string out;
  std::vector<std::string> only;
  std::vector<std::size_t> after_frames;
};

int export_from(const Arguments& arguments) {
  const auto wanted = [&](const char* kind) {
    return arguments.only.empty() ||
           std::find(arguments.only.begin(), arguments.only.end(), kind) != arguments.only.end();
  };
  std::error_code error;
  std::filesystem::create_directories(arguments.out, error);
  if (error || !std::filesystem::is_directory(arguments.out)) {
    throw std::runtime_error(arguments.out + " cannot be made a folder: " + error.message());
  }
  const ExportOptions options{arguments.log,     arguments.out,         wanted("csv"),
                              wanted("tum"),     wanted("ply"),         wanted("mesh"),
                              wanted("octomap"), arguments.after_frames};
  ExportResult result;
  {
    Progress progress("exporting " + arguments.log);
    result = export_log(options, [&progress](double fraction) { progress.update(fraction); });
  }
  for (const std::string& note : result.notes) spdlog::warn("{}", note);
  for (const std::string& file : result.files) fmt::print("{}\n", file);
  if (result.files.empty()) throw std::runtime_error("there was nothing to export");
  return kExitDone;
}

}  // namespace

int run_export(int argc, char** argv) {
  CLI::App app(
      "Turns a log into files for other programs: CHANNEL.csv of every channel, CHANNEL.tum of\n"
      "every pose channel; of the map as it is in the end map.ply (surfels), mesh.ply (triangles)\n"
      "and octomap.bt.\n\n"
      "Example: export derived.lcmlog --out exported/",
      "export");
  Arguments arguments;
  app.add_option("log", arguments.log, "a recorded or derived log")
      ->required()
      ->check(CLI::ExistingFile);
  app.add_option("--out", arguments.out, "folder of the files, made where missing")->required();
  app.add_option(
         "--only", arguments.only,
         "of csv, tum, ply, mesh, octomap those to write, separated by commas; default: all")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::IsMember({"csv", "tum", "ply", "mesh", "octomap"}));
  app.add_option("--after-frames", arguments.after_frames,
                 "also write map_after_N.ply, the map after that many VISUAL_POSE, for each of\n"
                 "these numbers, as in 10,100,300")
      ->delimiter(',')
      ->allow_extra_args(false)
      ->check(CLI::PositiveNumber);
  return run_command_line(app, argc, argv, [&] { return export_from(arguments); });
}

}  // namespace gastronaut
