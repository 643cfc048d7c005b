#include "evaluate/report.hpp"

#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <stdexcept>

#include "evaluate/report_script.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kDegreesPerRadian = 180 / std::numbers::pi;

class TextFile {
 public:
  explicit TextFile(const std::string& path) : path_(path), file_(std::fopen(path.c_str(), "w")) {
    if (file_ == nullptr) throw std::runtime_error("cannot write " + path);
  }
  ~TextFile() {
    if (file_ != nullptr) std::fclose(file_);
  }
  TextFile(const TextFile&) = delete;
  TextFile& operator=(const TextFile&) = delete;

  void text(const std::string& words) { std::fputs(words.c_str(), file_); }
  void first(std::int64_t value) { std::fprintf(file_, "%lld", static_cast<long long>(value)); }
  void number(double value) { std::fprintf(file_, ",%.9g", value); }
  void numbers(const Eigen::Vector3d& values) {
    for (const double value : values) number(value);
  }
  void pose(const std::optional<SE3>& pose) {
    const double nan = std::nan("");
    numbers(pose ? pose->translation : Eigen::Vector3d::Constant(nan));
    number(pose ? pose->rotation.w() : nan);
    numbers(pose ? Eigen::Vector3d(pose->rotation.vec()) : Eigen::Vector3d::Constant(nan));
  }
  void close() {
    const bool good = std::ferror(file_) == 0;
    const bool closed = std::fclose(file_) == 0;
    file_ = nullptr;
    if (!good || !closed) throw std::runtime_error("cannot write " + path_);
  }

 private:
  std::string path_;
  std::FILE* file_;
};

}  // namespace

void write_metrics(const std::string& path, const Metrics& metrics) {
  nlohmann::ordered_json json = nlohmann::ordered_json::object();
  for (const auto& [key, value] : metrics.list()) {
    std::visit([&json, &name = key](const auto& v) { json[name] = v; }, value);
  }
  std::ofstream file(path);
  // A damaged log may have brought bytes that are no text.
  file << json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << "\n";
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

void write_pose_series(const std::string& path, const PoseChannel& channel,
                       const PoseEvaluation& evaluation, std::span<const BoundSample> bounds) {
  TextFile file(path);
  file.text(
      "utime,status,usable,x,y,z,qw,qx,qy,qz,true_x,true_y,true_z,true_qw,true_qx,true_qy,true_qz,"
      "error_x,error_y,error_z,error,rotation_error_deg,sigma_position,sigma_rotation_deg,nees");
  for (const ExtraSeries& extra : channel.extras) file.text(std::string(",") + extra.name);
  if (!bounds.empty()) file.text(",bound_position,bound_axis_deg");
  file.text("\n");
  const double nan = std::nan("");
  auto bound = bounds.begin();
  for (std::size_t i = 0; i < channel.fixes.size(); ++i) {
    const PoseFix& fix = channel.fixes[i];
    const FixErrors& errors = evaluation.fixes[i];
    file.first(fix.utime);
    file.number(fix.status);
    file.number(channel.usable(fix) ? 1 : 0);
    file.pose(errors.aligned);
    file.pose(errors.truth);
    file.numbers(errors.truth ? errors.position : Eigen::Vector3d::Constant(nan));
    file.number(errors.truth ? errors.position.norm() : nan);
    file.number(errors.truth ? kDegreesPerRadian * errors.rotation : nan);
    const bool has_covariance = channel.covariance_size > 0;
    const Vector6d variances = fix.covariance.diagonal();
    file.number(has_covariance ? std::sqrt(variances.head<3>().sum()) : nan);
    file.number(has_covariance ? kDegreesPerRadian * std::sqrt(variances.tail<3>().sum()) : nan);
    file.number(errors.normalised_squared.value_or(nan));
    for (const ExtraSeries& extra : channel.extras) file.number(extra.values[i]);
    if (!bounds.empty()) {
      while (bound != bounds.end() && bound->utime < fix.utime) ++bound;
      const bool found = bound != bounds.end() && bound->utime == fix.utime;
      file.number(found ? bound->position : nan);
      file.number(found ? kDegreesPerRadian * bound->axis : nan);
    }
    file.text("\n");
  }
  file.close();
}

void write_sensor_health(const std::string& path, const SensorHealthSeries& health) {
  TextFile file(path);
  file.text("utime,p_nominal,alpha,used,sensor,cause\n");
  for (const auto& [name, series] : health) {
    for (const SensorHealth& sample : series) {
      file.first(sample.utime);
      file.number(sample.p_nominal);
      file.number(sample.alpha);
      file.number(sample.used ? 1 : 0);
      file.text("," + name + "," + sample.cause + "\n");
    }
  }
  file.close();
}

void write_truth_series(const std::string& path, const TruthTrack& truth) {
  TextFile file(path);
  file.text("utime,x,y,z,qw,qx,qy,qz\n");
  for (std::size_t i = 0; i < truth.size(); ++i) {
    file.first(truth.utimes()[i]);
    file.pose(truth.poses()[i]);
    file.text("\n");
  }
  file.close();
}

void write_depth_series(const std::string& folder, const DepthSeries& depth) {
  TextFile file(folder + "/DEPTH.csv");
  file.text("utime,mean_abs,rmse,relative,bias,mean_abs_scaled,scale,coverage,normalised_error\n");
  for (const DepthFrame& frame : depth.frames) {
    const ErrorSums& compared = frame.errors.compared;
    file.first(frame.utime);
    file.number(compared.mean_absolute());
    file.number(compared.rmse());
    file.number(compared.mean_relative());
    file.number(compared.bias());
    file.number(frame.errors.mean_absolute_scaled());
    file.number(compared.count > 0 ? frame.errors.scale : std::nan(""));
    file.number(frame.errors.coverage());
    file.number(frame.errors.normalised_error());
    file.text("\n");
  }
  file.close();

  TextFile profile(folder + "/DEPTH_by_distance.csv");
  profile.text("count,near,far,truth_pixels,mean_abs,rmse,bias\n");
  for (std::size_t i = 0; i < DepthProfile::kBins; ++i) {
    const DepthProfile::Bin& bin = depth.profile.bins()[i];
    profile.first(static_cast<std::int64_t>(bin.compared.count));
    profile.number(static_cast<double>(i) * DepthProfile::kBinWidth);
    profile.number(static_cast<double>(i + 1) * DepthProfile::kBinWidth);
    profile.number(static_cast<double>(bin.truth_pixels));
    profile.number(bin.compared.mean_absolute());
    profile.number(bin.compared.rmse());
    profile.number(bin.compared.bias());
    profile.text("\n");
  }
  profile.close();
}

bool set_timing_metrics(Metrics& metrics, const std::string& path) {
  std::ifstream file(path);
  if (!file) return false;
  try {
    const auto json = nlohmann::ordered_json::parse(file);
    metrics.set("replay.wall_seconds", json.at("wall_seconds").get<double>());
    metrics.set("replay.cpu_seconds", json.at("cpu_seconds").get<double>());
    metrics.set("replay.peak_resident_bytes", json.at("peak_resident_bytes").get<double>());
    for (const auto& [name, timing] : json.at("processes").items()) {
      metrics.set_count(name + ".events", timing.at("events").get<std::size_t>());
      metrics.set(name + ".ms_per_event.median", timing.at("ms_median").get<double>());
      metrics.set(name + ".ms_per_event.p99", timing.at("ms_p99").get<double>());
      metrics.set(name + ".ms_per_event.max", timing.at("ms_max").get<double>());
    }
  } catch (const nlohmann::json::exception& error) {
    throw std::runtime_error(path + ": " + error.what());
  }
  return true;
}

void draw_report(const std::string& folder, const std::string& surface) {
  // Paths travel in the environment, where no shell reads them.
  setenv("GASTRONAUT_REPORT", folder.c_str(), 1);
  setenv("GASTRONAUT_SURFACE", surface.c_str(), 1);
  const std::string command = std::string("'") + kPythonInterpreter + "' -";
  std::signal(SIGPIPE, SIG_IGN);  // an interpreter that dies is seen by its exit status
  std::FILE* script = popen(command.c_str(), "w");
  if (script == nullptr) throw std::runtime_error("cannot start " + command);
  std::fputs(kReportScript, script);
  if (pclose(script) != 0) {
    throw std::runtime_error(
        std::string("the plots were not drawn, for the reason above; metrics.json and the series "
                    "are complete. ") +
        kPythonInterpreter +
        " needs matplotlib and numpy, which scripts/install_dependencies installs");
  }
}

}  // namespace gastronaut::evaluation
