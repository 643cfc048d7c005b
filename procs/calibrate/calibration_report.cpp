#include "calibrate/calibration_report.hpp"

#include <spdlog/fmt/fmt.h>

#include <cmath>
#include <numbers>

#include "configuration/fields.hpp"

namespace gastronaut {
namespace {

constexpr double kMicro = 1e6;  // in one: micrometres in a metre, microtesla in a tesla
constexpr double kMilli = 1e3;
constexpr double kPercent = 100;
constexpr double kDegrees = 180 / std::numbers::pi;  // in a radian

// The sensors with what `remark` says of each.
template <class Remark>
void write_sensors(YAML::Emitter& out, FieldWriter& writer,
                   std::vector<HallSensorConfiguration> sensors, const Remark& remark) {
  out << YAML::Key << "sensors" << YAML::Value << YAML::BeginSeq;
  for (std::size_t s = 0; s < sensors.size(); ++s) {
    out << YAML::Comment(fmt::format("sensor {}{}", s, remark(s))) << YAML::Newline;
    out << YAML::BeginMap;
    sensors[s].fields(writer);
    out << YAML::EndMap;
  }
  out << YAML::EndSeq;
}

void write_coils(YAML::Emitter& out, FieldWriter& writer, const CoilsConfiguration& coils) {
  out << YAML::Key << "coils" << YAML::Value << YAML::BeginMap;
  const_cast<CoilsConfiguration&>(coils).fields(writer);  // `fields` serves reading too
  out << YAML::EndMap;
}

double root_mean_square(const Eigen::MatrixXd& values) {
  return std::sqrt(values.squaredNorm() / static_cast<double>(values.size()));
}

Eigen::Index worst_channel(const CoilCalibration& calibration) {
  Eigen::Index worst = 0;
  calibration.residual_rms.maxCoeff(&worst);
  return worst;
}

}  // namespace

std::string commented(const std::string& text) {
  std::string result = "# ";
  for (const char letter : text) {
    result += letter;
    if (letter == '\n') result += "# ";
  }
  return result.substr(0, result.find_last_not_of("# \n") + 1) + "\n";
}

std::string coil_table(const CoilCalibration& calibration) {
  const Eigen::Index worst = worst_channel(calibration);
  std::string text = fmt::format(
      "coil    own drive   current noise   field, rms   standard error, rms   (sensors and coils "
      "count from 0)\n");
  for (Eigen::Index coil = 0; coil < calibration.tesla_per_ampere.cols(); ++coil) {
    text += fmt::format("{:4}  {:9.3f} A  {:12.2f} mA  {:6.2f} uT/A  {:14.4f} uT/A\n", coil,
                        calibration.drive(coil), calibration.current_noise(coil) * kMilli,
                        root_mean_square(calibration.tesla_per_ampere.col(coil)) * kMicro,
                        root_mean_square(calibration.tesla_per_ampere_std.col(coil)) * kMicro);
  }
  text +=
      fmt::format("readings used                       {} ({:.2g} % of their values left out)\n",
                  calibration.readings_used, calibration.outlier_fraction * kPercent);
  text +=
      fmt::format("residual, rms                       {:.3f} uT; worst channel {}: {:.3f} uT\n",
                  root_mean_square(calibration.residual_rms) * kMicro, worst,
                  calibration.residual_rms(worst) * kMicro);
  text += fmt::format("offsets, standard error, rms        {:.3f} uT\n",
                      root_mean_square(calibration.offset_stds) * kMicro);
  text += fmt::format("pull of the current noise           {:.2g} % at most, corrected for\n",
                      calibration.largest_attenuation * kPercent);
  return text;
}

std::string coil_fragment(const CoilCalibration& calibration,
                          const std::optional<RigConfiguration>& rig, const std::string& log) {
  Eigen::Vector3d background = Eigen::Vector3d::Zero();
  RigConfiguration without_rig;
  without_rig.coils = {calibration.tesla_per_ampere, calibration.current_noise.mean()};
  const RigConfiguration calibrated =
      rig ? with_coils(*rig, calibration, &background) : without_rig;

  std::string head = fmt::format(
                         "Made by `calibrate coils` from {}. Give it after the rig's own "
                         "file: --config RIG.yaml --config THIS.yaml\n",
                         log) +
                     coil_table(calibration);
  if (rig) {
    head += fmt::format(
        "The uniform background during the log, ({:.2f}, {:.2f}, {:.2f}) uT, is not in the "
        "offsets.\n",
        background(0) * kMicro, background(1) * kMicro, background(2) * kMicro);
  } else {
    head +=
        "The log has no RIG_CONFIG. Readings without current, uniform background included, "
        "channel by channel in uT:\n";
    for (Eigen::Index c = 0; c < calibration.offsets.size(); ++c) {
      head += fmt::format("{:.3f}{}", calibration.offsets(c) * kMicro,
                          c + 1 == calibration.offsets.size() || c % 12 == 11 ? "\n" : ", ");
    }
  }
  YAML::Emitter out;
  FieldWriter writer(out);
  out << YAML::BeginMap;
  write_coils(out, writer, calibrated.coils);
  if (rig) {
    out << YAML::Key << "hall_array" << YAML::Value << YAML::BeginMap;
    writer("num_axes", calibrated.hall_array.num_axes);
    writer("offset_std", calibrated.hall_array.offset_std);
    const auto axes = static_cast<std::size_t>(calibrated.hall_array.num_axes);
    write_sensors(out, writer, calibrated.hall_array.sensors, [&](std::size_t s) {
      std::string remark = ": offset +-";
      for (std::size_t axis = 0; axis < axes; ++axis) {
        remark += fmt::format(
            "{}{:.3f}", axis == 0 ? "" : ", ",
            calibration.offset_stds(static_cast<Eigen::Index>(s * axes + axis)) * kMicro);
      }
      return remark + " uT";
    });
    out << YAML::EndMap;
  }
  out << YAML::EndMap;
  return commented(head) + out.c_str() + "\n";
}

std::string array_table(const ArrayCalibration& calibration, const RigConfiguration& before) {
  const HallArrayConfiguration& array = calibration.rig.hall_array;
  std::size_t worst = 0;
  for (std::size_t c = 0; c < calibration.deviations.size(); ++c) {
    if (calibration.deviations[c].offset > calibration.deviations[worst].offset) worst = c;
  }
  const auto configured = before.hall_array.resolved_sensors();
  Eigen::MatrixXd offset_change(calibration.deviations.size(), 1);
  Eigen::MatrixXd gain_change(calibration.deviations.size(), 1);
  Eigen::MatrixXd alignment_change(calibration.deviations.size(), 1);
  const auto axes = static_cast<std::size_t>(array.num_axes);
  for (std::size_t c = 0; c < calibration.deviations.size(); ++c) {
    const auto row = static_cast<Eigen::Index>(c);
    const auto axis = static_cast<Eigen::Index>(c % axes);
    const Eigen::RowVector3d old = configured[c / axes].response.row(axis);
    const Eigen::RowVector3d fresh = array.sensors[c / axes].response.row(axis);
    offset_change(row) =
        array.sensors[c / axes].offset[c % axes] - configured[c / axes].offset[c % axes];
    gain_change(row) = fresh.norm() / old.norm() - 1;
    alignment_change(row) = std::atan2(old.cross(fresh).norm(), old.dot(fresh)) / std::sqrt(2.0);
  }
  const auto line = [](const char* what, double change, double left, const char* unit) {
    return fmt::format("{:<22} {:12.3f} {:16.3f} {}\n", what, change, left, unit);
  };
  std::string text = fmt::format("{:<22} {:>12} {:>16}\n", "", "change, rms", "still unknown");
  text += line("gain", root_mean_square(gain_change) * kPercent, array.gain_std * kPercent, "%");
  text += line("alignment, each way", root_mean_square(alignment_change) * kDegrees,
               array.alignment_std * kDegrees, "degrees");
  text += line("offset", root_mean_square(offset_change) * kMicro, array.offset_std * kMicro, "uT");
  text += line("magnet's moment", (calibration.rig.magnet.moment - before.magnet.moment) * kMilli,
               calibration.rig.magnet.moment_std * kMilli, "mA m^2");
  text += fmt::format(
      "worst channel          {} (sensor {}, axis {}; counted from 0): gain {:.2f} %, "
      "alignment {:.2f} degrees, offset {:.2f} uT still unknown\n",
      worst, worst / axes, worst % axes, calibration.deviations[worst].gain * kPercent,
      calibration.deviations[worst].alignment * kDegrees,
      calibration.deviations[worst].offset * kMicro);
  text += fmt::format(
      "a fix errs for the array's sake by {:.2f} mm, {:.2f} degrees before; {:.2f} mm, "
      "{:.2f} degrees after\n",
      calibration.induced.prior_position * kMilli, calibration.induced.prior_axis * kDegrees,
      calibration.induced.position * kMilli, calibration.induced.axis * kDegrees);
  text += fmt::format("held-out readings      {}: residual {:.3f} uT before, {:.3f} uT after\n",
                      calibration.held_out, calibration.held_out_rms_before * kMicro,
                      calibration.held_out_rms_after * kMicro);
  text += fmt::format(
      "fit                    {} readings ({} left out), chi2 per degree of freedom "
      "{:.3f}\n",
      calibration.readings_used, calibration.readings_left_out, calibration.chi2_per_dof);
  text += fmt::format("uniform background     ({:.2f}, {:.2f}, {:.2f}) uT, not in the offsets\n",
                      calibration.background(0) * kMicro, calibration.background(1) * kMicro,
                      calibration.background(2) * kMicro);
  return text;
}

std::string array_fragment(const ArrayCalibration& calibration, const RigConfiguration& before,
                           const std::string& log) {
  const std::string head =
      fmt::format(
          "Made by `calibrate array` from {}. Give it after the rig's own file: --config "
          "RIG.yaml --config THIS.yaml\n",
          log) +
      array_table(calibration, before);
  const HallArrayConfiguration& array = calibration.rig.hall_array;
  const auto axes = static_cast<std::size_t>(array.num_axes);
  YAML::Emitter out;
  FieldWriter writer(out);
  out << YAML::BeginMap;
  out << YAML::Key << "magnet" << YAML::Value << YAML::BeginMap;
  writer("moment", calibration.rig.magnet.moment);
  writer("moment_std", calibration.rig.magnet.moment_std);
  out << YAML::EndMap;
  if (calibration.rig.coils.tesla_per_ampere.size() != 0) {
    write_coils(out, writer, calibration.rig.coils);
  }
  out << YAML::Key << "hall_array" << YAML::Value << YAML::BeginMap;
  writer("num_axes", array.num_axes);
  writer("gain_std", array.gain_std);
  writer("alignment_std", array.alignment_std);
  writer("offset_std", array.offset_std);
  write_sensors(out, writer, array.sensors, [&](std::size_t s) {
    JointArrayFit::ChannelDeviation worst;
    for (std::size_t c = s * axes; c < (s + 1) * axes; ++c) {
      worst.gain = std::max(worst.gain, calibration.deviations[c].gain);
      worst.alignment = std::max(worst.alignment, calibration.deviations[c].alignment);
      worst.offset = std::max(worst.offset, calibration.deviations[c].offset);
    }
    return fmt::format(": gain +-{:.2f} %, alignment +-{:.2f} degrees, offset +-{:.2f} uT",
                       worst.gain * kPercent, worst.alignment * kDegrees, worst.offset * kMicro);
  });
  out << YAML::EndMap;
  out << YAML::EndMap;
  return commented(head) + out.c_str() + "\n";
}

}  // namespace gastronaut
