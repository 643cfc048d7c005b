// Least squares over the poses of a hand-eye calibration, and what it can be believed to.
//
// Averaging a hundred fixes of one place does not take away what the Hall array's calibration makes
// of that place, nor vision's drift up to there. Beside the independent errors that the fixes
// report two poses therefore have in common
//   of the magnetic error m(30 mm) / 2 + m(100 mm) / 2, where m(reach) = (1 + x) exp(-x) is
//   Matern's
//     correlation of smooth fields, x = sqrt(3) hypot(distance, 30 mm * chord of the axes) / reach:
//     errors of single sensors, seen from some 8 cm, and what the whole array has in common, which
//     is what a calibration of the array leaves;
//   of vision's drift exp(-path between them / 60 mm), a random walk that a map holds in bounds.
// and each pose errs by itself beyond what its fixes report, as vision's frames do.
// How large all these are is measured from the residuals, by restricted maximum likelihood
// (Patterson and Thompson 1971). What visual_pose_t reports is not used: it is the drift since the
// map began, most of which the map's alignment takes up.
//
// The estimate itself weighs the poses as if they were independent, and the joint covariance V of
// their errors goes into its covariance alone, A J' W V W J A with A = (J' W J)^-1: generalised
// least squares would look at the differences between neighbours, which vision gets wrong in ways
// that go with the motion and that no V knows of.
#pragma once

#include <span>
#include <vector>

#include "calibrate/hand_eye_model.hpp"

namespace gastronaut {

// One sigma an axis.
struct HandEyeNoise {
  double own_position_std = 2e-4;       // metres, of each pose by itself, beside what fixes report
  double own_axis_std = 3e-3;           // radians
  double magnetic_position_std = 2e-4;  // of the magnetic error that depends on the place
  double magnetic_axis_std = 3e-3;
  double visual_position_std = 2e-4;  // of what vision has drifted
  double visual_axis_std = 3e-3;
};

// Of one pose's residual, beside what its fixes report.
Matrix5d hidden_covariance(const HandEyeNoise& noise);

// `prior`: gradient and information of what is known beside the rows, the information regular.
struct HandEyePrior {
  HandEyeVector gradient = HandEyeVector::Zero();
  HandEyeMatrix information = HandEyeMatrix::Zero();
};

// Sets the rows' weights, by their residuals in sigmas over `excess`.
void weigh(std::vector<HandEyeRow>& rows, const HandEyeNoise& noise, double excess = 1);
// How many times larger than that noise the residuals of most rows are; at least 1.
double typical_excess(std::span<const HandEyeRow> rows, const HandEyeNoise& noise);
// What weighted steps make smaller: the robust loss of the residuals in sigmas.
double robust_cost(std::span<const HandEyeRow> rows, const HandEyeNoise& noise);

// One Gauss-Newton step. `rows` in order of time, here and below.
HandEyeVector solve(std::span<const HandEyeRow> rows, const HandEyeNoise& noise,
                    const HandEyePrior& prior);

// Of what solve() finds.
HandEyeMatrix covariance_of_solution(std::span<const HandEyeRow> rows, const HandEyeNoise& noise,
                                     const HandEyePrior& prior);

struct HandEyeFitness {
  double log_likelihood = 0;  // of the residuals, restricted: whatever the unknowns are
  double chi2 = 0;            // after the generalised least squares step
};
HandEyeFitness fitness(std::span<const HandEyeRow> rows, const HandEyeNoise& noise,
                       const HandEyePrior& prior);

// The noise under which the rows are most likely.
HandEyeNoise measure_noise(std::span<const HandEyeRow> rows, const HandEyePrior& prior);

}  // namespace gastronaut
