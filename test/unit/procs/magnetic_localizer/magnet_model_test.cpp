#include "magnetic_localizer/magnet_model.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "unit/procs/magnetic_localizer/simulated_array.hpp"

namespace gastronaut::magnetics {
namespace {

// A central difference over steps h of a field that varies over centimetres errs by (h/cm)^2.
constexpr double kStep = 1e-5;
constexpr double kDifferenceError = 1e-4;
constexpr double kRounding = 1e-12;

struct Scene {
  RigConfiguration rig;
  SensorArray array{rig.hall_array};
  MagnetModel model{array, octupole_ratio(rig.magnet.shape())};
};

TEST(MagnetModel, FieldIsThatOfTheAxialMagnetAndTheBackground) {
  const Scene scene;
  test::Draws draws(1, 0);
  for (int i = 0; i < 10; ++i) {
    const MagnetState state = test::random_state(scene.rig, draws, 0.1, 0.02, 0.15);
    Eigen::VectorXd field;
    scene.model.field(state, field);
    ArrayField both(64);
    scene.model.field_and_derivatives(state, both);
    EXPECT_LT((both.field - field).norm(), kRounding * field.norm());
    const auto sensors = scene.rig.hall_array.resolved_sensors();
    for (Eigen::Index s = 0; s < 64; ++s) {
      const Eigen::Vector3d expected =
          axial_magnet_field(sensors[static_cast<std::size_t>(s)].position - state.position,
                             state.moment * state.axis, octupole_ratio(scene.rig.magnet.shape())) +
          state.background;
      const Eigen::Vector3d actual(field[s], field[64 + s], field[128 + s]);
      EXPECT_LT((actual - expected).norm(), kRounding * expected.norm());
    }
  }
}

TEST(MagnetModel, DerivativesAreThoseOfTheField) {
  const Scene scene;
  test::Draws draws(2, 0);
  for (int i = 0; i < 10; ++i) {
    const MagnetState state = test::random_state(scene.rig, draws, 0.1, 0.03, 0.15);
    ArrayField analytic(64);
    scene.model.field_and_derivatives(state, analytic);
    for (int unknown = 0; unknown < kNumMagnetUnknowns; ++unknown) {
      UnknownVector step = UnknownVector::Zero();
      step[unknown] = kStep;
      Eigen::VectorXd ahead;
      Eigen::VectorXd behind;
      scene.model.field(moved(state, step), ahead);
      scene.model.field(moved(state, -step), behind);
      const Eigen::VectorXd numeric = (ahead - behind) / (2 * kStep);
      EXPECT_LT((analytic.by_unknown.col(unknown) - numeric).norm(),
                kDifferenceError * numeric.norm())
          << "unknown " << unknown;
    }
  }
}

TEST(MagnetModel, AMovedStateTurnsAboutTheTangentBasis) {
  MagnetState state;
  state.axis = Eigen::Vector3d(0.2, -0.5, 0.7).normalized();
  UnknownVector step = UnknownVector::Zero();
  constexpr double kAngle = 0.3;  // radians
  step[kRotation] = kAngle;
  const Eigen::Vector3d turned = moved(state, step).axis;
  const Eigen::Vector3d about = perpendicular_basis(state.axis).col(0);
  EXPECT_NEAR(turned.dot(about), 0, kRounding);
  EXPECT_NEAR(state.axis.cross(turned).dot(about), std::sin(kAngle), kRounding);
}

}  // namespace
}  // namespace gastronaut::magnetics
