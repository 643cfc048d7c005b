#include "visual_slam/keyframe_window.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <stdexcept>
#include <utility>

#include "visual_slam/window_texture.hpp"

namespace gastronaut::slam {
namespace {

constexpr Eigen::Index kUnknowns = 6;  // of a keyframe: twist of its pose
constexpr double kAnchorStd = 1e-5;    // metres, radians: the first keyframe is where it is said
constexpr double kStartSigma = 0.3;    // normalised albedo; the residuals correct it
constexpr double kLeastSigma = 0.02;
constexpr float kValueGate = 3;
constexpr double kLargestStep = 0.1;    // of a keyframe: fraction of the working distance, radians
constexpr double kSmallestStep = 3e-4;  // in the same units: nothing to gain beyond
constexpr double kLargestRatio = 0.5;   // log: refined depths stay within this of those given
// Cauchy's weights see 0.785 of a Gaussian's variance when their scale is right.
constexpr double kCauchyVariance = 1 / 0.785;

double robust_rms(double square, double weight) {
  return std::sqrt(kCauchyVariance * square / weight);
}

Eigen::Index block(std::size_t keyframe) { return kUnknowns * static_cast<Eigen::Index>(keyframe); }

double median_depth(const Plane<float>& depth) {
  std::vector<float> known;
  std::copy_if(depth.values.begin(), depth.values.end(), std::back_inserter(known),
               [](float value) { return value > 0 && std::isfinite(value); });
  if (known.empty()) return 0;
  const auto middle = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2);
  std::nth_element(known.begin(), middle, known.end());
  return static_cast<double>(*middle);
}

PatchView patch_view(const SE3& target_T_host, double target_log_scale, double depth_gate,
                     double sigma) {
  PatchView view;
  const Eigen::Matrix3d rotation = target_T_host.rotation.toRotationMatrix();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      view.target_R_host[static_cast<std::size_t>(3 * i + j)] = static_cast<float>(rotation(i, j));
    }
    view.target_t_host[static_cast<std::size_t>(i)] =
        static_cast<float>(target_T_host.translation(i));
  }
  view.target_scale = static_cast<float>(std::exp(target_log_scale));
  view.depth_gate = static_cast<float>(depth_gate);
  view.value_gate = kValueGate;
  view.sigma = static_cast<float>(sigma);
  return view;
}

}  // namespace

// Normal equations (matrix twists = -gradient) in all keyframes' poses, without the fields; and
// what brings the fields back.
struct KeyframeWindow::Equations {
  struct Field {
    // Of the points' log ratios: information from other keyframes, with poses (poses x points).
    Eigen::VectorXd point_information;
    Eigen::MatrixXd point_coupling;
    Eigen::VectorXd point_gradient;
    double weight = 0;  // of all residuals of the points
    double square = 0;  // and of their squares
    // Of the nodes, without the points.
    NodeCholesky information;
    Eigen::MatrixXd coupling;  // nodes x poses
    Eigen::VectorXd gradient;
  };
  std::vector<Field> fields;  // of the hosts
  Eigen::MatrixXd matrix;
  Eigen::VectorXd gradient;
};

double KeyframeWindow::Keyframe::log_ratio(Eigen::Index point) const {
  return value_at(nodes[static_cast<std::size_t>(point)], field) + own(point);
}

KeyframeWindow::KeyframeWindow(const PinholeGrid& grid, const KeyframeWindowOptions& options)
    : grid_(grid), options_(options), nodes_(node_grid(grid, options.spacing * grid.width)) {
  if (options.keyframes < 2 || options.points < 1 || options.iterations < 1) {
    throw std::invalid_argument(
        "a window needs two keyframes, one point in each and one iteration at least");
  }
  clear();
}

void KeyframeWindow::clear() {
  keyframes_.clear();
  sigma_ = kStartSigma;
  prior_matrix_.resize(0, 0);
  prior_gradient_.resize(0);
  prior_poses_.clear();
}

void KeyframeWindow::add(const Frame& frame, const SE3& map_T_camera) {
  if (frame.grid != grid_ || !frame.depth.same_size(grid_.width, grid_.height) ||
      !frame.albedo.same_size(grid_.width, grid_.height)) {
    throw std::invalid_argument("a keyframe must have the window's grid");
  }
  if (keyframes_.size() == static_cast<std::size_t>(options_.keyframes)) marginalise_oldest();
  Keyframe keyframe;
  keyframe.utime = frame.utime;
  keyframe.relative_std = frame.relative_std;
  keyframe.depth = frame.depth;
  keyframe.texture = texture_of(frame, options_.contrast_reach, options_.contrast_floor);
  keyframe.distance = median_depth(frame.depth);
  keyframe.points =
      select_points(keyframe.texture, options_.points, options_.least_gradient, options_.jump);
  for (const WindowPoint& point : keyframe.points) {
    keyframe.nodes.push_back(node_weights(nodes_, point.u, point.v));
  }
  keyframe.field = Eigen::VectorXd::Zero(nodes_.size());
  keyframe.own = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(keyframe.points.size()));
  keyframe.prior = field_information(nodes_, std::max(frame.relative_std, options_.point_std),
                                     options_.range * grid_.width);
  keyframe.map_T_camera = map_T_camera;
  if (keyframes_.empty()) {
    prior_matrix_ = Eigen::MatrixXd::Zero(kUnknowns, kUnknowns);
    prior_matrix_.diagonal().head<6>().setConstant(1 / (kAnchorStd * kAnchorStd));
    prior_gradient_ = Eigen::VectorXd::Zero(kUnknowns);
    prior_poses_ = {map_T_camera};
    anchor_ = map_T_camera.translation;
  } else {
    keyframe.before_T_camera = keyframes_.back().map_T_camera.inverse() * map_T_camera;
  }
  keyframes_.push_back(std::move(keyframe));
}

void KeyframeWindow::transform(const Similarity& similarity) {
  const auto scale = static_cast<float>(similarity.scale);
  for (Keyframe& keyframe : keyframes_) {
    keyframe.map_T_camera = similarity * keyframe.map_T_camera;
    keyframe.before_T_camera.translation *= similarity.scale;
    keyframe.distance *= similarity.scale;
    for (float& depth : keyframe.depth.values) depth *= scale;
    for (Texel& texel : keyframe.texture.texels) texel.depth *= scale;
    for (WindowPoint& point : keyframe.points) {
      for (float& depth : point.depth) depth *= scale;
    }
  }
  for (SE3& pose : prior_poses_) pose = similarity * pose;
  const Eigen::VectorXd shrink =
      similarity.twist_factors().cwiseInverse().replicate(prior_gradient_.size() / kUnknowns, 1);
  prior_gradient_ = shrink.cwiseProduct(prior_gradient_).eval();
  prior_matrix_ = (shrink.asDiagonal() * prior_matrix_ * shrink.asDiagonal()).eval();
  anchor_ = similarity * anchor_;
}

KeyframeWindow::Equations KeyframeWindow::equations(std::size_t first_host,
                                                    std::size_t end_host) const {
  const Eigen::Index size = block(keyframes_.size());
  Equations result;
  result.matrix = Eigen::MatrixXd::Zero(size, size);
  result.gradient = Eigen::VectorXd::Zero(size);
  const double factor = 1 / (sigma_ * sigma_ * options_.dependence);
  std::vector<PatchSums> patches;
  for (std::size_t h = first_host; h < end_host; ++h) {
    const Keyframe& host = keyframes_[h];
    const auto count = static_cast<Eigen::Index>(host.points.size());
    Equations::Field& field = result.fields.emplace_back();
    Eigen::MatrixXd& coupling = field.point_coupling;
    Eigen::VectorXd& information = field.point_information;
    Eigen::VectorXd& by_ratio = field.point_gradient;
    coupling = Eigen::MatrixXd::Zero(size, count);
    information = Eigen::VectorXd::Zero(count);
    by_ratio = Eigen::VectorXd::Zero(count);
    std::vector<float> ratios;
    for (Eigen::Index i = 0; i < count; ++i) {
      ratios.push_back(static_cast<float>(std::exp(host.log_ratio(i))));
    }
    for (std::size_t t = 0; t < keyframes_.size(); ++t) {
      if (t == h) continue;
      const Keyframe& target = keyframes_[t];
      const SE3 target_T_host = target.map_T_camera.inverse() * host.map_T_camera;
      const ViewSums sums =
          look_at_patches(host.points, ratios, target.texture,
                          patch_view(target_T_host, target.field.mean(),
                                     options_.depth_gate + 4 * target.relative_std, sigma_),
                          patches);
      Matrix6d matrix;
      std::size_t k = 0;
      for (int i = 0; i < 6; ++i) {
        for (int j = i; j < 6; ++j) matrix(i, j) = matrix(j, i) = factor * sums.matrix[k++];
      }
      const Vector6d gradient = factor * Eigen::Map<const Vector6d>(sums.vector.data());
      // A twist of the host's pose is one of target_T_host seen from its other end; one of the
      // target's pose moves it the other way.
      const Matrix6d by_host = target_T_host.adjoint();
      const Eigen::Index a = block(h);
      const Eigen::Index b = block(t);
      const Matrix6d cross = by_host.transpose() * matrix;
      result.matrix.block<6, 6>(a, a) += cross * by_host;
      result.matrix.block<6, 6>(a, b) -= cross;
      result.matrix.block<6, 6>(b, a) -= cross.transpose();
      result.matrix.block<6, 6>(b, b) += matrix;
      result.gradient.segment<6>(a) += by_host.transpose() * gradient;
      result.gradient.segment<6>(b) -= gradient;
      for (Eigen::Index i = 0; i < count; ++i) {
        const PatchSums& patch = patches[static_cast<std::size_t>(i)];
        if (!(patch.weight > 0)) continue;
        const Vector6d by_both =
            factor *
            Eigen::Map<const Eigen::Matrix<float, 6, 1>>(patch.twist_ratio.data()).cast<double>();
        coupling.col(i).segment<6>(a) += by_host.transpose() * by_both;
        coupling.col(i).segment<6>(b) -= by_both;
        information(i) += factor * static_cast<double>(patch.ratio2);
        by_ratio(i) += factor * static_cast<double>(patch.ratio_residual);
        field.weight += static_cast<double>(patch.weight);
        field.square += static_cast<double>(patch.square);
      }
    }

    field.gradient = multiply(host.prior, host.field);
    field.coupling = Eigen::MatrixXd::Zero(nodes_.size(), size);
    NodeBand matrix = host.prior;
    const double prior = 1 / (options_.point_std * options_.point_std);
    for (Eigen::Index i = 0; i < count; ++i) {
      if (!(information(i) > 0)) continue;
      const double inverse = 1 / (information(i) + prior);
      const double left = prior * inverse;  // of what the point says, to the field
      const double own = inverse * (by_ratio(i) + prior * host.own(i));
      const auto by_poses = coupling.col(i);
      result.gradient -= own * by_poses;
      result.matrix.selfadjointView<Eigen::Lower>().rankUpdate(by_poses, -inverse);
      const NodeWeights& at = host.nodes[static_cast<std::size_t>(i)];
      for (std::size_t a = 0; a < 4; ++a) {
        field.gradient(at.node[a]) += at.weight[a] * (by_ratio(i) - information(i) * own);
        field.coupling.row(at.node[a]) += at.weight[a] * left * by_poses.transpose();
        for (std::size_t b = 0; b <= a; ++b) {
          matrix(at.node[a] - at.node[b], at.node[a]) +=
              at.weight[a] * at.weight[b] * left * information(i);
        }
      }
    }
    field.information.compute(matrix);
    const Eigen::MatrixXd half = field.information.half_solve(field.coupling);
    result.matrix.selfadjointView<Eigen::Lower>().rankUpdate(half.transpose(), -1);
    result.gradient -= half.transpose() * field.information.half_solve(field.gradient);
  }
  result.matrix.triangularView<Eigen::StrictlyUpper>() = result.matrix.transpose();
  return result;
}

// The motions from keyframes [0, end) to the next ones as they were told, and what those that left
// have said.
void KeyframeWindow::add_priors(Equations& equations, std::size_t end) const {
  for (std::size_t k = 0; k < end; ++k) {
    if (k + 1 == keyframes_.size()) break;
    const Keyframe& next = keyframes_[k + 1];
    const SE3 before_T_camera = keyframes_[k].map_T_camera.inverse() * next.map_T_camera;
    const Vector6d off = (next.before_T_camera.inverse() * before_T_camera).log();
    Vector6d weight = Vector6d::Constant(1 / (options_.pose_std * options_.pose_std));
    if (next.distance > 0) weight.head<3>() /= next.distance * next.distance;
    Eigen::Matrix<double, 6, 12> by_poses;
    by_poses << -before_T_camera.inverse().adjoint(), Matrix6d::Identity();
    Eigen::Matrix<double, 12, 1> gradient = by_poses.transpose() * weight.cwiseProduct(off);
    Eigen::Matrix<double, 12, 12> matrix = by_poses.transpose() * weight.asDiagonal() * by_poses;
    for (int i = 0; i < 2; ++i) {
      const Eigen::Index a = block(k + static_cast<std::size_t>(i));
      equations.gradient.segment<6>(a) += gradient.segment<6>(6 * i);
      for (int j = 0; j < 2; ++j) {
        equations.matrix.block<6, 6>(a, block(k + static_cast<std::size_t>(j))) +=
            matrix.block<6, 6>(6 * i, 6 * j);
      }
    }
  }
  const Eigen::Index size = prior_gradient_.size();
  Eigen::VectorXd off(size);
  for (std::size_t k = 0; k < prior_poses_.size(); ++k) {
    off.segment<6>(block(k)) = (prior_poses_[k].inverse() * keyframes_[k].map_T_camera).log();
  }
  equations.matrix.topLeftCorner(size, size) += prior_matrix_;
  equations.gradient.head(size) += prior_gradient_ + prior_matrix_ * off;
}

void KeyframeWindow::step(const Equations& equations, const Eigen::VectorXd& twists) {
  for (std::size_t k = 0; k < keyframes_.size(); ++k) {
    Keyframe& keyframe = keyframes_[k];
    const Equations::Field& field = equations.fields[k];
    keyframe.map_T_camera = keyframe.map_T_camera * SE3::exp(Vector6d(twists.segment<6>(block(k))));
    const Eigen::VectorXd change =
        -field.information.solve(field.gradient + field.coupling * twists);
    const double prior = 1 / (options_.point_std * options_.point_std);
    for (Eigen::Index i = 0; i < keyframe.own.size(); ++i) {
      const double information = field.point_information(i);
      if (!(information > 0)) continue;
      const double ratio = value_at(keyframe.nodes[static_cast<std::size_t>(i)], change);
      const double gradient = field.point_gradient(i) + prior * keyframe.own(i) +
                              information * ratio + field.point_coupling.col(i).dot(twists);
      keyframe.own(i) = std::clamp(keyframe.own(i) - gradient / (information + prior),
                                   -kLargestRatio, kLargestRatio);
    }
    keyframe.field = (keyframe.field + change).cwiseMax(-kLargestRatio).cwiseMin(kLargestRatio);
  }
}

void KeyframeWindow::marginalise_oldest() {
  Equations all = equations(0, 1);
  add_priors(all, 1);
  const Eigen::Index rest = all.gradient.size() - kUnknowns;
  const Eigen::LDLT<Eigen::MatrixXd> leaving(all.matrix.topLeftCorner(kUnknowns, kUnknowns));
  const Eigen::MatrixXd gain = leaving.solve(all.matrix.topRightCorner(kUnknowns, rest));
  prior_gradient_ = all.gradient.tail(rest) - gain.transpose() * all.gradient.head(kUnknowns);
  const Eigen::MatrixXd matrix = all.matrix.bottomRightCorner(rest, rest) -
                                 all.matrix.bottomLeftCorner(rest, kUnknowns) * gain;
  prior_matrix_ = (matrix + matrix.transpose()) / 2;
  keyframes_.pop_front();
  prior_poses_.clear();
  for (const Keyframe& keyframe : keyframes_) {
    prior_poses_.push_back(keyframe.map_T_camera);
  }
}

std::vector<RefinedKeyframe> KeyframeWindow::refine() {
  const auto all = [&] {
    Equations result = equations(0, keyframes_.size());
    add_priors(result, keyframes_.size());
    return result;
  };
  for (int i = 0; i < options_.iterations && !keyframes_.empty(); ++i) {
    const Equations now = all();
    Eigen::VectorXd twists = -now.matrix.ldlt().solve(now.gradient);
    if (!twists.allFinite()) break;
    double largest = 0;
    for (std::size_t k = 0; k < keyframes_.size(); ++k) {
      const Vector6d twist = twists.segment<6>(block(k));
      const double distance = std::max(keyframes_[k].distance, kAnchorStd);
      largest = std::max({largest, twist.head<3>().norm() / distance, twist.tail<3>().norm()});
    }
    if (largest > kLargestStep) twists *= kLargestStep / largest;
    step(now, twists);
    double weight = 0;
    double square = 0;
    for (const Equations::Field& field : now.fields) {
      weight += field.weight;
      square += field.square;
    }
    if (weight > 0) sigma_ = std::max(kLeastSigma, robust_rms(square, weight));
    if (largest < kSmallestStep) break;
  }
  std::vector<RefinedKeyframe> result;
  if (keyframes_.empty()) return result;
  const Equations now = all();
  const Eigen::MatrixXd covariance =
      now.matrix.ldlt().solve(Eigen::MatrixXd::Identity(now.matrix.rows(), now.matrix.cols()));
  for (std::size_t k = 0; k < keyframes_.size(); ++k) result.push_back(refined(k, now, covariance));
  return result;
}

RefinedKeyframe KeyframeWindow::refined(std::size_t index, const Equations& equations,
                                        const Eigen::MatrixXd& covariance) const {
  const Keyframe& keyframe = keyframes_[index];
  const Equations::Field& field = equations.fields[index];
  RefinedKeyframe result;
  result.utime = keyframe.utime;
  result.map_T_camera = keyframe.map_T_camera;
  result.covariance = covariance.block<6, 6>(block(index), block(index));
  // A scale that all share would stretch the whole path.
  const Eigen::Vector3d stretch =
      options_.scale_std *
      (keyframe.map_T_camera.rotation.inverse() * (keyframe.map_T_camera.translation - anchor_));
  result.covariance.topLeftCorner<3, 3>() += stretch * stretch.transpose();
  result.points = static_cast<int>((field.point_information.array() > 0).count());
  if (field.weight > 0) result.rgb_rms = robust_rms(field.square, field.weight);
  result.scale = std::exp(keyframe.field.mean());
  result.depth = keyframe.depth;
  multiply(nodes_, keyframe.field, result.depth);
  // What the poses leave open, and what they do not decide.
  const Eigen::MatrixXd by_poses = field.information.solve(field.coupling);
  const auto size = static_cast<double>(nodes_.size());
  const Eigen::MatrixXd half =
      field.information.half_solve(Eigen::MatrixXd::Identity(nodes_.size(), nodes_.size()));
  const double open = half.squaredNorm() / size;
  const double of_poses = (by_poses * covariance).cwiseProduct(by_poses).sum() / size;
  result.relative_std = std::sqrt(open + of_poses + options_.point_std * options_.point_std);
  return result;
}

}  // namespace gastronaut::slam
