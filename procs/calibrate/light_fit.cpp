#include "calibrate/light_fit.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

#include "calibrate/robust_weight.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut {
namespace {

constexpr double kPixelsOfSample = 9;
constexpr double kQuantisation = 0.3 / 255;  // of the level: rounding, and what JPEG rounds
// Modelled levels between which samples count: a sample taken for its measured level near the
// bounds within which samples are taken was taken for its noise.
constexpr double kDarkest = 26.0 / 255;
constexpr double kBrightest = 236.0 / 255;
constexpr double kNormalMad = 0.67449;    // median of |standard normal|
constexpr double kPlaceAlbedo = 0.07;     // one sigma of its logarithm, from place to place
constexpr double kMisfitScale = 0.1;      // of log light: a card that explains a picture errs less
constexpr double kOutOfSight = 10;        // log light, for what a card would leave unlit
constexpr int kTurns = 24;                // tried about a roll axis
constexpr std::size_t kSparse = 8;        // one sample in so many serves to compare cards
constexpr std::size_t kFewPictures = 24;  // and so many pictures
constexpr int kMostIterations = 60;
constexpr int kMostRounds = 10;      // of scatter and parameters in turn
constexpr double kConverged = 1e-6;  // squared step in units of the posterior
constexpr double kSettled = 0.05;    // relative, of scatter and doubt
constexpr double kLeastDamping = 1e-12;
constexpr double kMostDamping = 1e8;
constexpr double kMostClusters = 40;
constexpr Eigen::Index kLobe = 1;
constexpr Eigen::Index kVignetting = 2;
constexpr Eigen::Index kResponse = 3;

double squared(double value) { return value * value; }

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

struct LightFit::Place {
  double square = 0;
  double gradient = 0;
  Eigen::VectorXd mixed;  // by what is shared
};

struct LightFit::Normal {
  std::map<int, Place> places;
  Eigen::MatrixXd shared;  // J^T W J
  Eigen::MatrixXd mixed;   // shared by pose
  Matrix6d pose = Matrix6d::Zero();
  Eigen::VectorXd gradient;  // J^T W r
  Vector6d pose_gradient = Vector6d::Zero();
  double cost = 0;
};

LightFit::LightFit(const std::vector<LightPicture>& pictures, std::vector<Eigen::Vector3d> lights,
                   const Noise& noise, const LightParameters& start,
                   const Eigen::MatrixXd& information)
    : pictures_(pictures),
      lights_(std::move(lights)),
      noise_(noise),
      start_(start),
      has_card_(pictures.front().pose.has_value()),
      num_shared_(information.rows() + (has_card_ ? 3 : 0)) {
  state_.parameters = start;
  information_ = Eigen::MatrixXd::Zero(num_shared_, num_shared_);
  information_.topLeftCorner(information.rows(), information.cols()) = information;
  if (has_card_) {
    origin_ = pictures.front().pose->rig_T_camera.translation;
    for (const LightPicture& picture : pictures) {
      pose_priors_.push_back(picture.pose->rig_T_camera);
    }
    state_.poses = pose_priors_;
  } else {
    int places = 0;
    for (const LightPicture& picture : pictures) {
      for (const LightSample& sample : picture.samples) places = std::max(places, sample.place + 1);
    }
    state_.albedos.assign(static_cast<std::size_t>(places), 0.0);
    start_from(Eigen::Vector3d::Zero());
  }
}

Eigen::Vector3d LightFit::card_in_camera(const Eigen::Vector3d& card,
                                         const SE3& rig_T_camera) const {
  const double offset = 1 - card.dot(rig_T_camera.translation - origin_);
  return rig_T_camera.rotation.conjugate() * card / offset;
}

Eigen::Vector3d LightFit::plane_of(const State& state, std::size_t picture,
                                   const LightSample& sample) const {
  return has_card_ ? card_in_camera(state.parameters.card, state.poses[picture]) : sample.plane;
}

LightFit::Prediction LightFit::predict(const State& state, std::size_t picture,
                                       const LightSample& sample, double* by_response) const {
  const LightParameters& parameters = state.parameters;
  Prediction prediction;
  prediction.shading =
      shade(sample.ray, plane_of(state, picture, sample), lights_, parameters.lobe);
  prediction.lit = prediction.shading.lit;
  if (!prediction.lit) return prediction;
  const double albedo = has_card_ ? 0 : state.albedos[static_cast<std::size_t>(sample.place)];
  prediction.light = pictures_[picture].exposure *
                     std::exp(parameters.log_power + albedo + prediction.shading.log_light -
                              parameters.vignetting * std::log(sample.ray.norm()));
  const auto level = parameters.response.level(prediction.light, by_response);
  prediction.level = level.level;
  prediction.slope = level.slope;
  return prediction;
}

double LightFit::log_power_of(const LightPicture& picture, const LightSample& sample,
                              const Eigen::Vector3d& plane) const {
  const Shading shading = shade(sample.ray, plane, lights_, start_.lobe);
  if (!shading.lit) return kOutOfSight;
  return std::log(start_.response.light(sample.level) / picture.exposure) - shading.log_light +
         start_.vignetting * std::log(sample.ray.norm());
}

double LightFit::best_log_power(const Eigen::Vector3d& card) const {
  std::vector<double> powers;
  const std::size_t stride = std::max<std::size_t>(1, pictures_.size() / kFewPictures);
  for (std::size_t f = 0; f < pictures_.size(); f += stride) {
    const Eigen::Vector3d plane =
        has_card_ ? card_in_camera(card, state_.poses[f]) : Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < pictures_[f].samples.size(); i += kSparse) {
      const LightSample& sample = pictures_[f].samples[i];
      powers.push_back(log_power_of(pictures_[f], sample, has_card_ ? plane : sample.plane));
    }
  }
  return median(std::move(powers));
}

SE3 LightFit::turned(std::size_t picture, double angle) const {
  const CameraPosePrior& prior = *pictures_[picture].pose;
  SE3 turn;
  turn.rotation = so3_exp(angle * *prior.roll_axis);
  turn.translation = prior.roll_centre - turn.rotation * prior.roll_centre;
  return prior.rig_T_camera * turn;
}

double LightFit::best_turn(const Eigen::Vector3d& card, std::size_t picture, double log_power,
                           double* misfit) const {
  const bool turns = pictures_[picture].pose->roll_axis.has_value();
  double best_angle = 0;
  *misfit = std::numeric_limits<double>::infinity();
  for (int k = 0; k < (turns ? kTurns : 1); ++k) {
    const double angle = 2 * std::numbers::pi * k / kTurns;
    const Eigen::Vector3d plane = card_in_camera(
        card, turns ? turned(picture, angle) : pictures_[picture].pose->rig_T_camera);
    double sum = 0;
    for (std::size_t i = 0; i < pictures_[picture].samples.size(); i += kSparse) {
      const double excess =
          log_power_of(pictures_[picture], pictures_[picture].samples[i], plane) - log_power;
      sum += robust_loss(excess / kMisfitScale);
    }
    if (sum < *misfit) {
      *misfit = sum;
      best_angle = angle;
    }
  }
  return best_angle;
}

double LightFit::misfit(const Eigen::Vector3d& card) const {
  const double log_power = best_log_power(card);
  double sum = 0;
  const std::size_t stride = std::max<std::size_t>(1, pictures_.size() / kFewPictures);
  for (std::size_t f = 0; f < pictures_.size(); f += stride) {
    double of_picture = 0;
    best_turn(card, f, log_power, &of_picture);
    sum += of_picture;
  }
  return sum;
}

void LightFit::start_from(const Eigen::Vector3d& card) {
  state_.parameters = start_;
  std::fill(state_.albedos.begin(), state_.albedos.end(), 0.0);
  state_.parameters.card = card;
  if (has_card_) {
    for (std::size_t f = 0; f < pictures_.size(); ++f) {
      pose_priors_[f] = pictures_[f].pose->rig_T_camera;
    }
    state_.poses = pose_priors_;
  }
  state_.parameters.log_power = best_log_power(card);
  if (!has_card_) return;
  for (std::size_t f = 0; f < pictures_.size(); ++f) {
    if (!pictures_[f].pose->roll_axis) continue;
    double misfit = 0;
    // Nothing is known of the turn, so the prior may start from any: this one.
    pose_priors_[f] = turned(f, best_turn(card, f, state_.parameters.log_power, &misfit));
  }
  state_.poses = pose_priors_;
}

// Sigmas are fixed between rounds: a model that were brighter to have larger ones could buy itself
// better residuals. They follow from the modelled light: by the measured one, what is dark by
// chance would count for more.
void LightFit::weigh() {
  weightings_.resize(pictures_.size());
  for (std::size_t f = 0; f < pictures_.size(); ++f) {
    weightings_[f].clear();
    for (const LightSample& sample : pictures_[f].samples) {
      const Prediction prediction = predict(state_, f, sample, nullptr);
      const double light =
          prediction.lit ? prediction.light : state_.parameters.response.light(sample.level);
      const auto level = state_.parameters.response.level(light);
      const double variance = noise_.read * noise_.read + noise_.shot * noise_.shot * light;
      Weighting weighting;
      weighting.counts = prediction.lit && level.level > kDarkest && level.level < kBrightest;
      weighting.noise =
          level.slope * level.slope * variance / kPixelsOfSample + kQuantisation * kQuantisation;
      weighting.light = level.slope * light;
      weighting.lift = level.curvature * variance / 2;
      weighting.sigma = std::sqrt(weighting.noise + squared(scatter_ * weighting.light));
      weightings_[f].push_back(weighting);
    }
  }
}

LightFit::Normal LightFit::normal_of(const State& state, std::size_t picture) const {
  const LightParameters& parameters = state.parameters;
  const Eigen::Index num_response = parameters.response.num_parameters();
  Normal normal;
  normal.shared = Eigen::MatrixXd::Zero(num_shared_, num_shared_);
  normal.mixed = Eigen::MatrixXd::Zero(num_shared_, 6);
  normal.gradient = Eigen::VectorXd::Zero(num_shared_);
  Eigen::Matrix3d plane_by_card = Eigen::Matrix3d::Zero();
  Eigen::Matrix<double, 3, 6> plane_by_twist = Eigen::Matrix<double, 3, 6>::Zero();
  if (has_card_) {
    const SE3& rig_T_camera = state.poses[picture];
    const Eigen::Vector3d plane = card_in_camera(parameters.card, rig_T_camera);
    const Eigen::Vector3d way = rig_T_camera.translation - origin_;
    const double offset = 1 - parameters.card.dot(way);
    const Eigen::Matrix3d camera_R_rig = rig_T_camera.rotation.conjugate().toRotationMatrix();
    plane_by_card = (camera_R_rig + plane * way.transpose()) / offset;
    plane_by_twist << plane * plane.transpose(), skew(plane);
    const CameraPosePrior& prior = *pictures_[picture].pose;
    const Vector6d deviation = (pose_priors_[picture].inverse() * rig_T_camera).log();
    normal.pose = prior.information;
    normal.pose_gradient = prior.information * deviation;
    normal.cost = deviation.dot(normal.pose_gradient);
  }
  Eigen::VectorXd row(num_shared_);
  for (std::size_t i = 0; i < pictures_[picture].samples.size(); ++i) {
    const LightSample& sample = pictures_[picture].samples[i];
    const Weighting& weighting = weightings_[picture][i];
    if (!weighting.counts) continue;
    const Prediction prediction = predict(state, picture, sample, row.data() + kResponse);
    if (!prediction.lit) {
      normal.cost += robust_loss(sample.level / weighting.sigma);
      continue;
    }
    const double residual = (prediction.level + weighting.lift - sample.level) / weighting.sigma;
    normal.cost += robust_loss(residual);
    const double weight = robust_weight(residual);
    // d level / d log light
    const double strength = prediction.slope * prediction.light / weighting.sigma;
    row(0) = strength;
    row(kLobe) = strength * prediction.shading.by_lobe;
    row(kVignetting) = -strength * std::log(sample.ray.norm());
    row.segment(kResponse, num_response) /= weighting.sigma;
    if (has_card_) {
      const Eigen::RowVector3d by_plane = strength * prediction.shading.by_plane.transpose();
      row.tail<3>() = by_plane * plane_by_card;
      const Eigen::Matrix<double, 1, 6> by_twist = by_plane * plane_by_twist;
      normal.mixed.noalias() += weight * row * by_twist;
      normal.pose.noalias() += weight * by_twist.transpose() * by_twist;
      normal.pose_gradient.noalias() += weight * residual * by_twist.transpose();
    } else {
      Place& place = normal.places[sample.place];
      if (place.mixed.size() == 0) place.mixed = Eigen::VectorXd::Zero(num_shared_);
      place.square += weight * strength * strength;
      place.gradient += weight * strength * residual;
      place.mixed.noalias() += weight * strength * row;
    }
    normal.shared.selfadjointView<Eigen::Lower>().rankUpdate(row, weight);
    normal.gradient.noalias() += weight * residual * row;
  }
  normal.shared = Eigen::MatrixXd(normal.shared.selfadjointView<Eigen::Lower>());
  return normal;
}

std::vector<LightFit::Normal> LightFit::normals(const State& state) const {
  std::vector<Normal> result(pictures_.size());
  parallel_for_chunks(pictures_.size(), 1,
                      [&](std::size_t f, std::size_t) { result[f] = normal_of(state, f); });
  return result;
}

// Of all pictures, priors included.
std::vector<LightFit::Place> LightFit::join_places(const std::vector<Normal>& parts,
                                                   const State& state) const {
  constexpr double kInformation = 1 / (kPlaceAlbedo * kPlaceAlbedo);
  std::vector<Place> places;
  for (const double albedo : state.albedos) {
    places.push_back({kInformation, kInformation * albedo, Eigen::VectorXd::Zero(num_shared_)});
  }
  for (const Normal& part : parts) {
    for (const auto& [number, of_part] : part.places) {
      Place& place = places[static_cast<std::size_t>(number)];
      place.square += of_part.square;
      place.gradient += of_part.gradient;
      place.mixed += of_part.mixed;
    }
  }
  return places;
}

double LightFit::total_cost(const std::vector<Normal>& parts, const State& state) const {
  const Eigen::VectorXd deviation = prior_deviation(state.parameters);
  double cost = doubt_ * deviation.dot(information_ * deviation);
  for (const double albedo : state.albedos) cost += squared(albedo / kPlaceAlbedo);
  for (const Normal& part : parts) cost += part.cost;
  return cost;
}

Eigen::VectorXd LightFit::prior_deviation(const LightParameters& parameters) const {
  Eigen::VectorXd deviation = Eigen::VectorXd::Zero(num_shared_);
  deviation(0) = parameters.log_power - start_.log_power;
  deviation(kLobe) = parameters.lobe - start_.lobe;
  deviation(kVignetting) = parameters.vignetting - start_.vignetting;
  deviation.segment(kResponse, parameters.response.num_parameters()) =
      parameters.response.parameters() - start_.response.parameters();
  return deviation;
}

LightParameters LightFit::moved(const LightParameters& from, const Eigen::VectorXd& step) const {
  LightParameters to = from;
  to.log_power += step(0);
  to.lobe += step(kLobe);
  to.vignetting += step(kVignetting);
  to.response.set_parameters(from.response.parameters() +
                             step.segment(kResponse, from.response.num_parameters()));
  if (has_card_) to.card += step.tail<3>();
  return to;
}

// Levenberg-Marquardt at fixed sigmas.
bool LightFit::descend() {
  double damping = 1e-4;
  std::vector<Normal> parts = normals(state_);
  cost_ = total_cost(parts, state_);
  for (int iteration = 0; iteration < kMostIterations; ++iteration) {
    Eigen::MatrixXd system = doubt_ * information_;
    Eigen::VectorXd gradient = system * prior_deviation(state_.parameters);
    for (const Normal& part : parts) {
      system += part.shared;
      gradient += part.gradient;
    }
    const std::vector<Place> places = join_places(parts, state_);
    while (true) {
      Eigen::MatrixXd reduced = system;
      reduced.diagonal() *= 1 + damping;
      Eigen::VectorXd right = gradient;
      std::vector<Eigen::LDLT<Matrix6d>> factors;
      for (std::size_t f = 0; f < state_.poses.size(); ++f) {
        Matrix6d damped = parts[f].pose;
        damped.diagonal() *= 1 + damping;
        factors.emplace_back(damped);
        reduced -= parts[f].mixed * factors.back().solve(parts[f].mixed.transpose());
        right -= parts[f].mixed * factors.back().solve(parts[f].pose_gradient);
      }
      for (const Place& place : places) {
        const double square = place.square * (1 + damping);
        reduced -= place.mixed * place.mixed.transpose() / square;
        right -= place.mixed * place.gradient / square;
      }
      const Eigen::VectorXd step = -reduced.ldlt().solve(right);
      State next = state_;
      next.parameters = moved(state_.parameters, step);
      for (std::size_t f = 0; f < factors.size(); ++f) {
        const Vector6d twist =
            -factors[f].solve(parts[f].pose_gradient + parts[f].mixed.transpose() * step);
        next.poses[f] = state_.poses[f] * SE3::exp(twist);
      }
      for (std::size_t i = 0; i < places.size(); ++i) {
        next.albedos[i] -=
            (places[i].gradient + places[i].mixed.dot(step)) / (places[i].square * (1 + damping));
      }
      std::vector<Normal> next_parts = normals(next);
      const double cost = total_cost(next_parts, next);
      const bool small = step.dot(reduced * step) < kConverged;
      if (cost < cost_ || (small && cost <= cost_ + kConverged)) {
        state_ = std::move(next);
        parts = std::move(next_parts);
        cost_ = cost;
        damping = std::max(kLeastDamping, damping / 10);
        if (small) return true;
        break;
      }
      damping *= 10;
      if (damping > kMostDamping) return small;
    }
  }
  return false;
}

// The scatter at which a typical residual is one sigma; none where noise alone explains more.
void LightFit::fit_scatter() {
  const std::vector<Residual> errors = residuals();
  const auto typical = [&](double scatter) {
    std::vector<double> sigmas;
    for (const Residual& error : errors) {
      const Weighting& weighting = weightings_[error.picture][error.sample];
      sigmas.push_back(std::abs(error.level) /
                       std::sqrt(weighting.noise + squared(scatter * weighting.light)));
    }
    return median(std::move(sigmas)) / kNormalMad;
  };
  scatter_ = 0;
  residual_scale_ = typical(0);
  if (residual_scale_ <= 1) return;
  double low = 0;
  double high = 1;
  constexpr int kHalvings = 30;
  for (int i = 0; i < kHalvings; ++i) {
    scatter_ = (low + high) / 2;
    (typical(scatter_) > 1 ? low : high) = scatter_;
  }
  residual_scale_ = 1;
}

bool LightFit::solve(const std::function<void(double)>& progress) {
  for (int round = 0; round < kMostRounds; ++round) {
    weigh();
    if (!descend()) return false;
    progress(static_cast<double>(round + 1) / kMostRounds);
    const double scatter = scatter_;
    const double doubt = doubt_;
    fit_scatter();
    find_covariance();
    if (std::abs(scatter_ - scatter) <= kSettled * scatter &&
        std::abs(doubt_ - doubt) <= kSettled * doubt) {
      break;
    }
  }
  return true;
}

// (J^T S^-1 J)^-1 with poses and places eliminated, times the residuals' scale squared, times by
// how much more the pictures' scores scatter than those of independent samples would: the sum over
// groups of pictures of s^T H^-1 s is the number of parameters where they are independent. Priors
// are believed as they are.
void LightFit::find_covariance() {
  const std::vector<Normal> parts = normals(state_);
  const std::vector<Place> places = join_places(parts, state_);
  Eigen::MatrixXd system = Eigen::MatrixXd::Zero(num_shared_, num_shared_);
  for (const Place& place : places) {
    system -= place.mixed * place.mixed.transpose() / place.square;
  }
  const double groups = std::min(kMostClusters, static_cast<double>(parts.size()));
  Eigen::MatrixXd scores = Eigen::MatrixXd::Zero(num_shared_, static_cast<Eigen::Index>(groups));
  for (std::size_t f = 0; f < parts.size(); ++f) {
    const Normal& part = parts[f];
    auto score = scores.col(static_cast<Eigen::Index>(static_cast<double>(f) * groups /
                                                      static_cast<double>(parts.size())));
    system += part.shared;
    score += part.gradient;
    for (const auto& [number, of_part] : part.places) {
      const Place& place = places[static_cast<std::size_t>(number)];
      score -= place.mixed * of_part.gradient / place.square;
    }
    if (!has_card_) continue;
    const Eigen::LDLT<Matrix6d> factor(part.pose);
    system -= part.mixed * factor.solve(part.mixed.transpose());
    score -= part.mixed * factor.solve(part.pose_gradient);
  }
  const auto identity = Eigen::MatrixXd::Identity(num_shared_, num_shared_);
  const Eigen::MatrixXd believed = (system + doubt_ * information_).ldlt().solve(identity);
  // What the priors know is not the pictures' to confirm: count what these determine.
  const double determined = (believed * system).trace();
  const double spread = (scores.transpose() * believed * scores).trace() / determined;
  const double scale = squared(residual_scale_);
  inflation_ = std::max(1.0, spread / scale * groups / (groups - 1));
  doubt_ = scale * inflation_;
  covariance_ = doubt_ * (system + doubt_ * information_).ldlt().solve(identity);
}

std::vector<LightFit::Residual> LightFit::residuals() const {
  std::vector<Residual> result;
  for (std::size_t f = 0; f < pictures_.size(); ++f) {
    for (std::size_t i = 0; i < pictures_[f].samples.size(); ++i) {
      if (!weightings_[f][i].counts) continue;
      const LightSample& sample = pictures_[f].samples[i];
      const Prediction prediction = predict(state_, f, sample, nullptr);
      if (!prediction.lit) continue;
      Residual residual;
      residual.picture = f;
      residual.sample = i;
      residual.depth = 1 / plane_of(state_, f, sample).dot(sample.ray);
      residual.level = sample.level - prediction.level - weightings_[f][i].lift;
      residual.relative = residual.level / (prediction.slope * prediction.light);
      residual.sigmas = residual.level / weightings_[f][i].sigma;
      result.push_back(residual);
    }
  }
  return result;
}

}  // namespace gastronaut
