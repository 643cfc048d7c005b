#include "calibrate/hand_eye_solver.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "calibrate/robust_weight.hpp"

namespace gastronaut {
namespace {

constexpr double kTypicalNorm = 2.09;  // median of the norm of five standard normal numbers
// Metres. Gains and alignments that are wrong in each sensor by itself make errors of the fix that
// are half alike 20, 30, 37 mm apart when the array is 60, 85, 110 mm away, and when the axis has
// turned by 0.5 to 0.75 radians.
constexpr double kSensorReach = 0.03;
constexpr double kArrayReach = 0.1;
constexpr double kRadianOfMagnet = 0.03;
constexpr double kRadianOfCamera = 0.02;  // metres of path that turning counts for
constexpr double kVisualReach = 0.06;     // metres of path: pictures of one place share a map
constexpr double kUsualWithin = 2;        // sigma of the logarithm of what is usual: a factor of 7
constexpr double kFirstFactor = 4;
constexpr double kLastFactor = 1.3;

struct Deviation {
  double HandEyeNoise::*member;
  double least;  // nothing beside what any fix reports
  double most;   // more than any rig shows
};
constexpr std::array<Deviation, 6> kDeviations = {{
    {&HandEyeNoise::own_position_std, 1e-5, 0.05},
    {&HandEyeNoise::own_axis_std, 1e-4, 1},
    {&HandEyeNoise::magnetic_position_std, 1e-5, 0.05},
    {&HandEyeNoise::magnetic_axis_std, 1e-4, 1},
    {&HandEyeNoise::visual_position_std, 1e-5, 0.05},
    {&HandEyeNoise::visual_axis_std, 1e-4, 1},
}};

// Path up to each row, metres; turning counts too, for then vision tracks what is new to it.
std::vector<double> path_of(std::span<const HandEyeRow> rows) {
  std::vector<double> path(rows.size(), 0);
  for (std::size_t i = 1; i < rows.size(); ++i) {
    path[i] = path[i - 1] + (rows[i].position - rows[i - 1].position).norm() +
              kRadianOfCamera * (rows[i].axis - rows[i - 1].axis).norm();
  }
  return path;
}

Matrix5d own_covariance(const HandEyeRow& row, const HandEyeNoise& noise) {
  return row.covariance + hidden_covariance(noise);
}

// Norm of the residual.
double in_sigmas(const HandEyeRow& row, const HandEyeNoise& noise) {
  return std::sqrt(row.residual.dot(own_covariance(row, noise).llt().solve(row.residual)));
}

// Of the errors that depend on the place.
double magnetic_correlation(const HandEyeRow& a, const HandEyeRow& b) {
  const double apart =
      std::hypot((a.position - b.position).norm(), kRadianOfMagnet * (a.axis - b.axis).norm());
  const auto matern = [apart](double reach) {
    const double x = std::sqrt(3.0) * apart / reach;
    return (1 + x) * std::exp(-x);
  };
  return (matern(kSensorReach) + matern(kArrayReach)) / 2;
}

// Lower triangle of the joint covariance of all residuals.
Eigen::MatrixXd joint_covariance(std::span<const HandEyeRow> rows, const HandEyeNoise& noise) {
  const auto size = static_cast<Eigen::Index>(5 * rows.size());
  Eigen::MatrixXd joint = Eigen::MatrixXd::Zero(size, size);
  const std::vector<double> path = path_of(rows);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(5 * i);
    for (std::size_t j = 0; j < i; ++j) {
      const double alike = magnetic_correlation(rows[i], rows[j]);
      const double weight = 1 / std::sqrt(rows[i].weight * rows[j].weight);
      const double seen_alike = std::exp(-(path[i] - path[j]) / kVisualReach);
      const auto shared = [&](double magnetic, double visual) {
        return weight * (alike * magnetic * magnetic + seen_alike * visual * visual);
      };
      const auto other = static_cast<Eigen::Index>(5 * j);
      joint.block<3, 3>(at, other).diagonal().setConstant(
          shared(noise.magnetic_position_std, noise.visual_position_std));
      joint.block<2, 2>(at + 3, other + 3) =
          shared(noise.magnetic_axis_std, noise.visual_axis_std) * rows[i].basis.transpose() *
          rows[j].basis;
    }
    joint.block<5, 5>(at, at) = own_covariance(rows[i], noise) / rows[i].weight;
  }
  return joint;
}

// Jacobian and residual of all rows, side by side.
Eigen::MatrixXd stacked(std::span<const HandEyeRow> rows) {
  Eigen::MatrixXd all(static_cast<Eigen::Index>(5 * rows.size()), kHandEyeSize + 1);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    all.middleRows<5>(static_cast<Eigen::Index>(5 * i)) << rows[i].jacobian, rows[i].residual;
  }
  return all;
}

// Each row by the square root of its own weight: W^(1/2) of the header.
void whiten_independently(std::span<const HandEyeRow> rows, const HandEyeNoise& noise,
                          Eigen::MatrixXd& values) {
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Eigen::LLT<Matrix5d> factor(own_covariance(rows[i], noise) / rows[i].weight);
    auto block = values.middleRows<5>(static_cast<Eigen::Index>(5 * i));
    factor.matrixL().solveInPlace(block);
  }
}

// The normal equations of whitened rows and the prior, factored with a unit diagonal, for they join
// metres, radians and seconds.
class NormalEquations {
 public:
  NormalEquations(const Eigen::MatrixXd& whitened, const HandEyePrior& prior)
      : gradient_(prior.gradient +
                  whitened.leftCols<kHandEyeSize>().transpose() * whitened.col(kHandEyeSize)) {
    const auto jacobian = whitened.leftCols<kHandEyeSize>();
    const HandEyeMatrix information = prior.information + jacobian.transpose() * jacobian;
    unit_ = information.diagonal().cwiseSqrt().cwiseInverse();
    factor_.compute(unit_.asDiagonal() * information * unit_.asDiagonal());
  }

  const HandEyeVector& gradient() const { return gradient_; }
  HandEyeVector step() const {
    return unit_.cwiseProduct(factor_.solve(unit_.cwiseProduct(gradient_)));
  }
  HandEyeMatrix inverse() const {
    return unit_.asDiagonal() * factor_.solve(HandEyeMatrix(unit_.asDiagonal()));
  }
  double log_determinant() const {
    return 2 * (factor_.matrixLLT().diagonal().array().log().sum() - unit_.array().log().sum());
  }

 private:
  HandEyeVector gradient_;
  HandEyeVector unit_;
  Eigen::LLT<HandEyeMatrix> factor_;
};

}  // namespace

Matrix5d hidden_covariance(const HandEyeNoise& noise) {
  const auto variance = [](double own, double magnetic, double visual) {
    return own * own + magnetic * magnetic + visual * visual;
  };
  Vector5d variances;
  variances.head<3>().setConstant(
      variance(noise.own_position_std, noise.magnetic_position_std, noise.visual_position_std));
  variances.tail<2>().setConstant(
      variance(noise.own_axis_std, noise.magnetic_axis_std, noise.visual_axis_std));
  return variances.asDiagonal();
}

void weigh(std::vector<HandEyeRow>& rows, const HandEyeNoise& noise, double excess) {
  for (HandEyeRow& row : rows) row.weight = robust_weight(in_sigmas(row, noise) / excess);
}

double typical_excess(std::span<const HandEyeRow> rows, const HandEyeNoise& noise) {
  std::vector<double> norms;
  for (const HandEyeRow& row : rows) norms.push_back(in_sigmas(row, noise));
  const auto middle = norms.begin() + static_cast<std::ptrdiff_t>(norms.size() / 2);
  std::nth_element(norms.begin(), middle, norms.end());
  return std::max(1.0, *middle / kTypicalNorm);
}

double robust_cost(std::span<const HandEyeRow> rows, const HandEyeNoise& noise) {
  double cost = 0;
  for (const HandEyeRow& row : rows) cost += robust_loss(in_sigmas(row, noise));
  return cost;
}

HandEyeVector solve(std::span<const HandEyeRow> rows, const HandEyeNoise& noise,
                    const HandEyePrior& prior) {
  Eigen::MatrixXd whitened = stacked(rows);
  whiten_independently(rows, noise, whitened);
  return NormalEquations(whitened, prior).step();
}

HandEyeMatrix covariance_of_solution(std::span<const HandEyeRow> rows, const HandEyeNoise& noise,
                                     const HandEyePrior& prior) {
  Eigen::MatrixXd whitened = stacked(rows);
  whiten_independently(rows, noise, whitened);
  const HandEyeMatrix a = NormalEquations(whitened, prior).inverse();
  // W J: the whitening once more, transposed.
  Eigen::MatrixXd weighted = whitened.leftCols<kHandEyeSize>();
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Eigen::LLT<Matrix5d> factor(own_covariance(rows[i], noise) / rows[i].weight);
    auto block = weighted.middleRows<5>(static_cast<Eigen::Index>(5 * i));
    factor.matrixU().solveInPlace(block);
  }
  const Eigen::MatrixXd joint = joint_covariance(rows, noise);
  const HandEyeMatrix spread =
      weighted.transpose() * joint.selfadjointView<Eigen::Lower>() * weighted;
  return a * (spread + prior.information) * a;
}

HandEyeFitness fitness(std::span<const HandEyeRow> rows, const HandEyeNoise& noise,
                       const HandEyePrior& prior) {
  Eigen::MatrixXd whitened = stacked(rows);
  Eigen::MatrixXd joint = joint_covariance(rows, noise);
  const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> factor(joint);
  factor.matrixL().solveInPlace(whitened);
  const NormalEquations equations(whitened, prior);
  const HandEyeVector step = equations.step();
  const auto residual = whitened.col(kHandEyeSize);
  HandEyeFitness fitness;
  fitness.chi2 = (residual - whitened.leftCols<kHandEyeSize>() * step).squaredNorm();
  fitness.log_likelihood =
      -0.5 * (2 * joint.diagonal().array().log().sum() + equations.log_determinant() +
              residual.squaredNorm() - equations.gradient().dot(step));
  return fitness;
}

HandEyeNoise measure_noise(std::span<const HandEyeRow> rows, const HandEyePrior& prior) {
  const HandEyeNoise usual;
  const auto likelihood = [&](const HandEyeNoise& noise) {
    double value = fitness(rows, noise, prior).log_likelihood;
    // Where the motion cannot tell, as of poses so near each other that they share all, the usual.
    for (const Deviation& deviation : kDeviations) {
      const double times = std::log(noise.*deviation.member / (usual.*deviation.member));
      value -= std::pow(times / kUsualWithin, 2) / 2;
    }
    return value;
  };
  HandEyeNoise best;
  double best_likelihood = -std::numeric_limits<double>::infinity();
  const auto improve = [&](const HandEyeNoise& candidate) {
    const double value = likelihood(candidate);
    if (!(value > best_likelihood)) return false;
    best = candidate;
    best_likelihood = value;
    return true;
  };
  // Changes one deviation by this factor as long as that helps, up or else down.
  const auto climb = [&](const Deviation& deviation, double factor) {
    for (const double step : {factor, 1 / factor}) {
      bool moved = false;
      while (true) {
        HandEyeNoise candidate = best;
        double& value = candidate.*deviation.member;
        value *= step;
        if (value < deviation.least || value > deviation.most || !improve(candidate)) break;
        moved = true;
      }
      if (moved) return;
    }
  };
  improve(usual);
  for (double factor = kFirstFactor; factor > kLastFactor; factor = std::sqrt(factor)) {
    for (const Deviation& deviation : kDeviations) climb(deviation, factor);
  }
  return best;
}

}  // namespace gastronaut
