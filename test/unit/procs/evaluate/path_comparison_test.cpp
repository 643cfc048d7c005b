#include "evaluate/path_comparison.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <variant>

namespace gastronaut::evaluation {
namespace {

constexpr std::int64_t kStart = 1700000000000000;  // microseconds
constexpr std::int64_t kPeriod = 50000;
constexpr double kSpeed = 0.01;  // metres a second
constexpr double kPath = 0.305;  // metres: a place where no piece ends
constexpr double kRotation = 0.7;
// Sums over the samples of a piece, at least 100 of them, against integrals over it.
constexpr double kSampling = 0.02;

int count() { return static_cast<int>(std::lround(kPath / kSpeed * 1e6 / kPeriod)) + 1; }

Eigen::Vector3d place(int sample) {
  return {kSpeed * static_cast<double>(sample * kPeriod) * 1e-6, 0, 0};
}

TruthTrack straight_path() {
  TruthTrack truth;
  for (int i = 0; i < count(); ++i) {
    truth.add(kStart + i * kPeriod, {Eigen::Quaterniond::Identity(), place(i)});
  }
  return truth;
}

// The path as one sees it who takes it for `scale` times as long, from a turned frame or not.
MatchedTrajectory seen(double scale, double rotation) {
  const Eigen::Matrix3d turn =
      Eigen::AngleAxisd(rotation, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  MatchedTrajectory matched;
  for (int i = 0; i < count(); ++i) {
    matched.estimate.utimes.push_back(kStart + i * kPeriod);
    matched.estimate.poses.push_back({turn, turn * (scale * place(i))});
    matched.truth.push_back(Pose{Eigen::Matrix3d::Identity(), place(i)});
  }
  return matched;
}

std::optional<double> find(const Metrics& metrics, const std::string& key) {
  for (const auto& [name, value] : metrics.list()) {
    if (name != key) continue;
    if (const double* number = std::get_if<double>(&value)) return *number;
    return static_cast<double>(std::get<std::int64_t>(value));
  }
  return std::nullopt;
}

TEST(PathPiecesTest, BeginEveryStepAlongThePath) {
  const std::vector<PathPiece> pieces = path_pieces(straight_path(), 0.05, 0.02);
  // 0, 20, ... 240 mm: the next would end at 310 mm.
  ASSERT_EQ(pieces.size(), 13U);
  for (std::size_t i = 0; i < pieces.size(); ++i) {
    // 20 mm take 2 s and 50 mm take 5 s; times are rounded to microseconds.
    EXPECT_NEAR(static_cast<double>(pieces[i].begin - kStart), 2e6 * static_cast<double>(i), 1);
    EXPECT_NEAR(static_cast<double>(pieces[i].end - pieces[i].begin), 5e6, 1);
  }
}

TEST(PathPiecesTest, AreNoneWhereThePathIsTooShort) {
  EXPECT_TRUE(path_pieces(straight_path(), 0.31, 0.02).empty());
  EXPECT_TRUE(path_pieces(TruthTrack{}, 0.05, 0.02).empty());
  TruthTrack standing;
  standing.add(kStart, SE3{});
  standing.add(kStart + kPeriod, SE3{});
  EXPECT_TRUE(path_pieces(standing, 0.05, 0.02).empty());
}

TEST(PathComparisonTest, AnErrorOfScaleGrowsWithTheLengthAndIsNotAlignedAway) {
  constexpr double kScaleError = 0.02;
  Metrics metrics;
  const MatchedTrajectory fused = seen(1 + kScaleError, 0);
  set_comparison_metrics(metrics, straight_path(), {{{"FUSED", fused, true}}});
  for (const int length : {50, 100, 150, 200}) {
    const std::string key = "comparison." + std::to_string(length) + "mm.FUSED";
    const double metres = 1e-3 * length;
    // Around its middle a piece errs by e s with s even in -L/2 .. L/2.
    const double aligned = kScaleError * metres / std::sqrt(12.0);
    EXPECT_NEAR(find(metrics, key + ".se3").value(), aligned, kSampling * aligned);
    // Not aligned by e s with s even in a .. a + L.
    double unaligned = 0;
    int pieces = 0;
    for (double a = 0; a + metres <= kPath; a += 0.02, ++pieces) {
      unaligned += kScaleError * std::sqrt(a * a + a * metres + metres * metres / 3);
    }
    unaligned /= pieces;
    EXPECT_EQ(find(metrics, key + ".count").value(), pieces);
    EXPECT_NEAR(find(metrics, key + ".none").value(), unaligned, kSampling * unaligned);
  }
}

TEST(PathComparisonTest, AMapsOwnFrameCostsNothing) {
  Metrics metrics;
  const MatchedTrajectory vision = seen(1, kRotation);
  set_comparison_metrics(metrics, straight_path(), {{{"VISION", vision, false}}});
  EXPECT_NEAR(find(metrics, "comparison.200mm.VISION.se3").value(), 0, 1e-12);  // rounding
  EXPECT_FALSE(find(metrics, "comparison.200mm.VISION.none"));
}

// Nothing from 15 to 17 s, that is from 150 to 170 mm.
MatchedTrajectory with_hole(const MatchedTrajectory& matched) {
  MatchedTrajectory result;
  for (std::size_t i = 0; i < matched.estimate.size(); ++i) {
    if (i >= 300 && i < 340) continue;
    result.estimate.utimes.push_back(matched.estimate.utimes[i]);
    result.estimate.poses.push_back(matched.estimate.poses[i]);
    result.truth.push_back(matched.truth[i]);
  }
  return result;
}

TEST(PathComparisonTest, PiecesThatTheChannelDidNotFollowDoNotCount) {
  const MatchedTrajectory vision = with_hole(seen(1, 0));
  Metrics metrics;
  set_comparison_metrics(metrics, straight_path(), {{{"VISION", vision, false}}});
  // Those from 120, 140 and 160 mm on lose 10 to 20 of their 50 mm; that from 100 mm ends there.
  EXPECT_EQ(find(metrics, "comparison.50mm.VISION.count"), 13 - 3);
  // Of 150 mm, 20 are more than a tenth; only the first piece ends before them.
  EXPECT_EQ(find(metrics, "comparison.150mm.VISION.count"), 1);
  // All pieces of 200 mm contain them, which are just a tenth: too little to drop them.
  EXPECT_EQ(find(metrics, "comparison.200mm.VISION.count"), 6);
}

TEST(PathComparisonTest, AllAreComparedOnThePiecesThatAllFollowed) {
  const MatchedTrajectory vision = with_hole(seen(1, 0));
  // Errs only where vision is blind.
  MatchedTrajectory fused = seen(1, 0);
  for (std::size_t i = 300; i < 340; ++i) fused.estimate.poses[i].translation.y() += 0.01;
  const MatchedTrajectory nothing;
  Metrics metrics;
  set_comparison_metrics(
      metrics, straight_path(),
      {{{"VISION", vision, false}, {"FUSED", fused, true}, {"MAGNET", nothing, true}}});
  EXPECT_EQ(find(metrics, "comparison.50mm.VISION.followed"), 13 - 3);
  EXPECT_EQ(find(metrics, "comparison.50mm.FUSED.followed"), 13);
  EXPECT_EQ(find(metrics, "comparison.50mm.VISION.count"), 13 - 3);
  EXPECT_EQ(find(metrics, "comparison.50mm.FUSED.count"), 13 - 3);
  // The piece from 100 mm on ends with the first erring sample, of 101.
  EXPECT_LT(find(metrics, "comparison.50mm.FUSED.none").value(),
            0.01 / std::sqrt(101.0) / 10 * 1.1);
  // One that never followed does not keep the others from being compared.
  EXPECT_FALSE(find(metrics, "comparison.50mm.MAGNET.followed"));
}

TEST(PathComparisonTest, WithoutCommonPiecesThereIsNothingToCompare) {
  const auto slice = [](std::size_t first, std::size_t last) {
    const MatchedTrajectory all = seen(1, 0);
    MatchedTrajectory result;
    for (std::size_t i = first; i < last; ++i) {
      result.estimate.utimes.push_back(all.estimate.utimes[i]);
      result.estimate.poses.push_back(all.estimate.poses[i]);
      result.truth.push_back(all.truth[i]);
    }
    return result;
  };
  // Of a piece, a tenth may be missing.
  const MatchedTrajectory early = slice(0, 320);
  const MatchedTrajectory late = slice(320, static_cast<std::size_t>(count()));
  Metrics metrics;
  set_comparison_metrics(metrics, straight_path(),
                         {{{"EARLY", early, true}, {"LATE", late, true}}});
  EXPECT_GT(find(metrics, "comparison.50mm.EARLY.followed"), 0);
  EXPECT_GT(find(metrics, "comparison.50mm.LATE.followed"), 0);
  EXPECT_EQ(find(metrics, "comparison.50mm.LATE.count"), 0);
  EXPECT_FALSE(find(metrics, "comparison.50mm.LATE.none"));
}

}  // namespace
}  // namespace gastronaut::evaluation
