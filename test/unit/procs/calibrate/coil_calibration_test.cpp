#include "calibrate/coil_calibration.hpp"

#include <gmock/gmock.h>

#include "array_simulation.hpp"
#include "numerics/counter_random.hpp"

namespace gastronaut {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const ArrayPriors kErrors;

class CoilCalibrationTest : public testing::Test {
 protected:
  CoilCalibration calibrate(const std::vector<CalibrationReading>& readings) const {
    return calibrate_coils(readings, 3, Eigen::VectorXd::Constant(4, truth_.coils.current_noise),
                           rig_);
  }
  std::string refusal(const SimulatedRun& run) const {
    try {
      calibrate(simulate(truth_, run));
    } catch (const CalibrationRefused& refused) {
      return refused.what();
    }
    return "accepted";
  }

  const RigConfiguration rig_ = simulated_rig(3);
  RigConfiguration truth_ = with_sensor_errors(rig_, kErrors, 5);
  SimulatedRun run_{nullptr, independent_currents, {18e-6, -6e-6, -42e-6}, 400};
};

TEST_F(CoilCalibrationTest, ErrsAsMuchAsItsStandardErrorsSay) {
  constexpr int kSeeds = 10;
  double squares = 0;
  double within_one = 0;
  double within_three = 0;
  double count = 0;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    run_.seed = static_cast<std::uint64_t>(seed);
    const CoilCalibration result = calibrate(simulate(truth_, run_));
    const Eigen::ArrayXXd errors =
        (result.tesla_per_ampere - truth_.coils.tesla_per_ampere).array() /
        result.tesla_per_ampere_std.array();
    squares += errors.square().sum();
    within_one += static_cast<double>((errors.abs() < 1).count());
    within_three += static_cast<double>((errors.abs() < 3).count());
    count += static_cast<double>(errors.size());
  }
  // Current noise is common to all channels of a seed: fewer independent errors than entries.
  constexpr double kBand = 0.06;
  constexpr double kNormalWithinOne = 0.683;
  constexpr double kNearlyAllWithinThree = 0.99;
  EXPECT_NEAR(within_one / count, kNormalWithinOne, kBand);
  EXPECT_GT(within_three / count, kNearlyAllWithinThree);
  EXPECT_NEAR(squares / count, 1, 3 * kBand);
}

TEST_F(CoilCalibrationTest, CorrectsThePullOfCurrentNoise) {
  truth_.coils.current_noise = 0.2;  // ampere, on a drive of 1.4 A rms: pulls by 2 %
  run_.readings = 4000;
  const CoilCalibration result = calibrate(simulate(truth_, run_));
  const double drive_squared = 2.0;  // 2 A peak
  const double pull = 0.2 * 0.2 / (drive_squared + 0.2 * 0.2);
  const double scale = result.tesla_per_ampere.cwiseProduct(truth_.coils.tesla_per_ampere).sum() /
                       truth_.coils.tesla_per_ampere.squaredNorm();
  constexpr double kFewerThanAThirdLeft = 0.33;
  EXPECT_NEAR(scale, 1, kFewerThanAThirdLeft * pull);
  constexpr double kChannelsDiffer = 0.5;
  EXPECT_NEAR(result.largest_attenuation, pull, kChannelsDiffer * pull);
}

TEST_F(CoilCalibrationTest, SeparatesBackgroundFromOffsets) {
  const CoilCalibration result = calibrate(simulate(truth_, run_));
  Eigen::Vector3d background;
  const RigConfiguration calibrated = with_coils(rig_, result, &background);
  // The mean of 16 offsets that scatter by 5 uT counts as background.
  const double split = kErrors.offset_std / std::sqrt(16);
  constexpr double kFourSigmas = 4;
  EXPECT_LT((background - run_.background).norm(), kFourSigmas * std::sqrt(3) * split);
  double sum = 0;
  for (const auto& sensor : calibrated.hall_array.sensors) sum += sensor.offset[0];
  constexpr double kRounding = 1e-12;  // tesla
  EXPECT_NEAR(sum, 0, kRounding) << "what is left in the offsets has no uniform part";
}

TEST_F(CoilCalibrationTest, IsNotMisledBySpikes) {
  auto readings = simulate(truth_, run_);
  constexpr std::size_t kEvery = 20;
  const double spike = 500e-6;  // tesla
  for (std::size_t i = 0; i < readings.size(); i += kEvery) readings[i].field.array() += spike;
  const CoilCalibration result = calibrate(readings);
  const Eigen::ArrayXXd errors = (result.tesla_per_ampere - truth_.coils.tesla_per_ampere).array() /
                                 result.tesla_per_ampere_std.array();
  constexpr double kStillConsistent = 1.5;
  EXPECT_LT(std::sqrt(errors.square().mean()), kStillConsistent);
  constexpr double kShare = 1.0 / kEvery;
  constexpr double kChance = 0.005;  // good values beyond Tukey's limit
  EXPECT_NEAR(result.outlier_fraction, kShare, kChance);
}

TEST_F(CoilCalibrationTest, NamesACoilThatWasNeverDriven) {
  run_.currents = [](double phase) {
    Eigen::VectorXd currents = independent_currents(phase);
    currents(3) = 0;
    return currents;
  };
  EXPECT_THAT(refusal(run_), HasSubstr("coil 3 was never driven above 0.05 A"));
}

TEST_F(CoilCalibrationTest, NamesACoilThatWasHeld) {
  run_.currents = [](double phase) {
    Eigen::VectorXd currents = independent_currents(phase);
    currents(1) = 1.2;
    return currents;
  };
  EXPECT_THAT(refusal(run_), HasSubstr("coil 1 was held at 1.20 A"));
}

TEST_F(CoilCalibrationTest, NamesCoilsThatWereDrivenTogether) {
  run_.currents = [](double phase) {
    Eigen::VectorXd currents = independent_currents(phase);
    currents(2) = -0.5 * currents(0);
    return currents;
  };
  EXPECT_THAT(refusal(run_), HasSubstr("coils 0 and 2 were always driven together"));
}

TEST_F(CoilCalibrationTest, CountsThePatternsOfAnActuationLog) {
  run_.currents = [](double phase) {
    const Eigen::VectorXd two = independent_currents(phase);
    Eigen::VectorXd currents(4);
    currents << two(0) + two(1), two(0) - two(1), 0.5 * two(0) + two(1), two(0) - 0.7 * two(1);
    return currents;
  };
  EXPECT_THAT(refusal(run_), HasSubstr("coils 0, 1, 2 and 3 were driven in only 2 independent"));
}

TEST_F(CoilCalibrationTest, RefusesAMovingMagnet) {
  run_.path = wide_path;
  EXPECT_THAT(refusal(run_), AllOf(HasSubstr("currents do not explain"), HasSubstr("magnet")));
}

TEST_F(CoilCalibrationTest, RefusesARestingMagnet) {
  run_.path = [](double) { return wide_path(0.3); };
  EXPECT_THAT(refusal(run_), HasSubstr("a magnet lies within the array's reach"));
}

TEST_F(CoilCalibrationTest, RefusesAChangingBackground) {
  auto readings = simulate(truth_, run_);
  const double drift = 5e-6;  // tesla, over the log
  for (std::size_t i = 0; i < readings.size(); ++i) {
    const double share = static_cast<double>(i) / static_cast<double>(readings.size());
    for (Eigen::Index c = 2; c < readings[i].field.size(); c += 3) {
      readings[i].field(c) += drift * share * share;
    }
  }
  try {
    calibrate(readings);
    FAIL() << "accepted";
  } catch (const CalibrationRefused& refused) {
    EXPECT_THAT(refused.what(), HasSubstr("uniform background changed"));
  }
}

TEST_F(CoilCalibrationTest, RefusesTooFewReadings) {
  run_.readings = 30;
  EXPECT_THAT(refusal(run_), HasSubstr("at least 50"));
}

TEST(CurrentNoise, IsMeasuredBesideSmoothDriveAndSteps) {
  const CounterRandom random(1, 0);
  constexpr Eigen::Index kSamples = 2000;
  constexpr double kNoise = 0.004;  // ampere
  Eigen::MatrixXd samples(kSamples, 1);
  for (Eigen::Index i = 0; i < kSamples; ++i) {
    const double step = i % 100 < 50 ? 2 : -2;
    samples(i, 0) = step + 3 * std::sin(0.01 * static_cast<double>(i)) +
                    kNoise * random.normal(static_cast<std::uint64_t>(i));
  }
  constexpr double kBand = 0.15;  // of the median of 2000, with steps in 8 % of the differences
  EXPECT_NEAR(measure_current_noise(samples)(0), kNoise, kBand * kNoise);
}

}  // namespace
}  // namespace gastronaut
