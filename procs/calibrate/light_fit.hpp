// The least-squares problem of `calibrate light`: residuals, derivatives, steps.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "calibrate/light_model.hpp"
#include "calibrate/light_samples.hpp"

namespace gastronaut {

// What all pictures share. As one vector: log power, lobe, vignetting, response, and the card where
// poses are known.
struct LightParameters {
  double log_power = 0;  // log of led_intensity times albedo
  double lobe = 1;
  double vignetting = 1;  // power of the ray's cosine
  ResponseCurve response = ResponseCurve::with_gamma(2.2);
  // card . (X - first picture's camera) = 1 in the rig frame, 1/metres
  Eigen::Vector3d card = Eigen::Vector3d::Zero();
};

class LightFit {
 public:
  // One sigma of the camera's noise in light: sqrt(read^2 + shot^2 light).
  struct Noise {
    double read = 0;
    double shot = 0;
  };
  // `information` about the start's parameters, the card left out. `pictures` must outlive the fit.
  LightFit(const std::vector<LightPicture>& pictures, std::vector<Eigen::Vector3d> lights,
           const Noise& noise, const LightParameters& start, const Eigen::MatrixXd& information);

  // How badly a card at this place explains the pictures, at the power that suits it best, each
  // picture turned about its roll axis as suits it best. For comparing cards.
  double misfit(const Eigen::Vector3d& card) const;
  // Starts from there, with that power and those turns.
  void start_from(const Eigen::Vector3d& card);
  // Goes on from where it stands, fitting the scatter along. False: it did not converge.
  bool solve(const std::function<void(double)>& progress);

  const LightParameters& parameters() const { return state_.parameters; }
  double cost() const { return cost_; }
  double scatter() const { return scatter_; }
  double residual_scale() const { return residual_scale_; }
  double inflation() const { return inflation_; }
  // Of the parameters' vector, inflated by what the residuals say. Valid after solve().
  const Eigen::MatrixXd& covariance() const { return covariance_; }

  struct Residual {
    std::size_t picture = 0;
    std::size_t sample = 0;  // of the picture
    double depth = 0;        // metres
    double level = 0;        // measured less modelled, 0 to 1
    double relative = 0;     // the same in light, over the light
    double sigmas = 0;
  };
  std::vector<Residual> residuals() const;

 private:
  struct Weighting {
    bool counts = true;
    double sigma = 1;  // of the level, scatter included
    double noise = 0;  // its variance without
    double light = 0;  // by which it changes with the light, relative
    double lift = 0;   // of the mean level, by noise through the curved response
  };
  struct Prediction {
    bool lit = false;
    double level = 0;
    double light = 0;
    double slope = 0;
    Shading shading;
  };
  struct Place;   // what the normal equations have of one place's albedo
  struct Normal;  // one picture's part of the normal equations
  struct State {
    LightParameters parameters;
    std::vector<SE3> poses;       // of a card's pictures
    std::vector<double> albedos;  // of tissue's places: logarithms, about the power's
  };

  Eigen::Vector3d plane_of(const State& state, std::size_t picture,
                           const LightSample& sample) const;
  Prediction predict(const State& state, std::size_t picture, const LightSample& sample,
                     double* by_response) const;
  Eigen::Vector3d card_in_camera(const Eigen::Vector3d& card, const SE3& rig_T_camera) const;
  // log of the light that the level tells less that of unit power.
  double log_power_of(const LightPicture& picture, const LightSample& sample,
                      const Eigen::Vector3d& plane) const;
  SE3 turned(std::size_t picture, double angle) const;
  double best_turn(const Eigen::Vector3d& card, std::size_t picture, double log_power,
                   double* misfit) const;
  double best_log_power(const Eigen::Vector3d& card) const;

  void weigh();
  Normal normal_of(const State& state, std::size_t picture) const;
  std::vector<Normal> normals(const State& state) const;
  std::vector<Place> join_places(const std::vector<Normal>& parts, const State& state) const;
  double total_cost(const std::vector<Normal>& parts, const State& state) const;
  Eigen::VectorXd prior_deviation(const LightParameters& parameters) const;
  LightParameters moved(const LightParameters& from, const Eigen::VectorXd& step) const;
  bool descend();
  void fit_scatter();
  void find_covariance();

  const std::vector<LightPicture>& pictures_;
  std::vector<Eigen::Vector3d> lights_;
  Noise noise_;
  LightParameters start_;
  Eigen::MatrixXd information_;  // padded with zeros for the card
  bool has_card_;
  Eigen::Index num_shared_;
  Eigen::Vector3d origin_ = Eigen::Vector3d::Zero();

  State state_;
  std::vector<SE3> pose_priors_;
  std::vector<std::vector<Weighting>> weightings_;
  double cost_ = 0;
  double scatter_ = 0.1;  // relative, of light; a start has much of it
  double residual_scale_ = 1;
  double inflation_ = 1;
  double doubt_ = 1;  // residual_scale_^2 inflation_: by how much the pictures are believed less
  Eigen::MatrixXd covariance_;
};

}  // namespace gastronaut
