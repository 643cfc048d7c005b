#include "magnetic_localizer/magnet_fit.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <utility>

namespace gastronaut::magnetics {
namespace {

constexpr int kMostEvaluations = 60;
// Expected gain in misfit (squared standard deviations) of another step that is not worth taking.
constexpr double kConverged = 1e-6;
constexpr double kFirstDamping = 1e-3;
constexpr double kLeastDamping = 1e-7;
constexpr double kMostDamping = 1e8;
constexpr double kDampingFactor = 10;
// A step longer than this part of the distance to the array leaves the region where the linear
// model means anything.
constexpr double kLongestStep = 0.5;

void evaluate_with_prior(Estimator& estimator, const Prior& prior, const MagnetState& state,
                         NormalEquations& equations) {
  estimator.evaluate(state, equations);
  const double background_weight = 1 / (prior.background_std * prior.background_std);
  equations.information.diagonal().segment<3>(kBackground).array() += background_weight;
  equations.gradient.segment<3>(kBackground) -= background_weight * state.background;
  equations.misfit += background_weight * state.background.squaredNorm();
  if (prior.moment_std > 0) {
    const double moment_weight = 1 / (prior.moment_std * prior.moment_std);
    const double off = state.moment - prior.moment;
    equations.information(kMoment, kMoment) += moment_weight;
    equations.gradient[kMoment] -= moment_weight * off;
    equations.misfit += moment_weight * off * off;
  } else {
    equations.information.row(kMoment).setZero();
    equations.information.col(kMoment).setZero();
    equations.information(kMoment, kMoment) = 1;
    equations.gradient[kMoment] = 0;
  }
}

}  // namespace

MagnetFit fit_magnet(Estimator& estimator, const Prior& prior, const MagnetState& start) {
  MagnetFit fit;
  fit.state = start;
  NormalEquations here;
  NormalEquations there;
  evaluate_with_prior(estimator, prior, fit.state, here);
  double damping = 0;
  for (int evaluations = 1; evaluations < kMostEvaluations && damping < kMostDamping;) {
    UnknownMatrix damped = here.information;
    damped.diagonal() *= 1 + damping;
    const Eigen::LLT<UnknownMatrix> factor(damped);
    const UnknownVector step = factor.solve(here.gradient);
    const double gain = step.dot(here.gradient);
    // Written so that a NaN is refused.
    const bool solved = factor.info() == Eigen::Success && gain >= 0;
    if (solved && gain < kConverged && damping < 1) {
      fit.converged = true;
      break;
    }
    bool accepted = false;
    const double reach = kLongestStep * (fit.state.position - estimator.centre()).norm();
    if (solved && step.segment<3>(kPosition).norm() < reach) {
      const MagnetState moved_state = moved(fit.state, step);
      evaluate_with_prior(estimator, prior, moved_state, there);
      ++evaluations;
      if (there.misfit < here.misfit) {
        accepted = true;
        fit.state = moved_state;
        std::swap(here, there);
      }
    }
    if (!accepted) {
      damping = std::max(kFirstDamping, damping * kDampingFactor);
    } else {
      damping = damping > kLeastDamping ? damping / kDampingFactor : 0;
    }
  }
  fit.misfit = here.misfit;
  if (!fit.converged) return fit;
  const Eigen::LLT<UnknownMatrix> factor(here.information);
  fit.covariance = factor.solve(UnknownMatrix::Identity());
  if (prior.moment_std == 0) fit.covariance(kMoment, kMoment) = 0;
  fit.converged = fit.covariance.allFinite();
  return fit;
}

}  // namespace gastronaut::magnetics
