#include "sensor_fusion/failure_cause.hpp"

#include <map>

#include "gastronaut/magnetic_pose_t.hpp"

namespace gastronaut::fusion {
namespace {

constexpr double kSharpnessMemory = 0.05;
constexpr double kBlurred = 0.6;    // of the usual sharpness
constexpr double kSpecular = 0.15;  // of the pixels are highlights

}  // namespace

void VisualCause::add(const PictureQuality& picture) {
  picture_ = picture;
  if (!(picture.sharpness > 0) || !picture.failure.empty()) return;
  if (usual_sharpness_ == 0) usual_sharpness_ = picture.sharpness;
  // Blurred pictures are no standard.
  if (picture.sharpness < kBlurred * usual_sharpness_) return;
  usual_sharpness_ += kSharpnessMemory * (picture.sharpness - usual_sharpness_);
}

std::string VisualCause::describe(bool is_lost) const {
  static const std::map<std::string, std::string> words = {
      {"veiled", "blur"},       {"black", "dark"},   {"unlit", "dark"},
      {"white", "overexposed"}, {"size", "corrupt"}, {"unexplained", "foreign light"}};
  if (!picture_.failure.empty()) {
    const auto word = words.find(picture_.failure);
    return word != words.end() ? word->second : picture_.failure;
  }
  if (picture_.sharpness > 0 && picture_.sharpness < kBlurred * usual_sharpness_) return "blur";
  if (picture_.highlight_fraction > kSpecular) return "specular";
  return is_lost ? "lost" : "low texture";
}

std::string magnetic_cause(int status) {
  switch (status) {
    case magnetic_pose_t::STATUS_OK:
      return {};
    case magnetic_pose_t::STATUS_TOO_FAR:
      return "too far";
    case magnetic_pose_t::STATUS_INTERFERENCE:
      return "interference";
    case magnetic_pose_t::STATUS_SATURATED:
      return "saturated";
    case magnetic_pose_t::STATUS_NO_CURRENTS:
      return "no coil currents";
    default:
      return "no fix";
  }
}

}  // namespace gastronaut::fusion
