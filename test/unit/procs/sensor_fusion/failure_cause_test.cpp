#include "sensor_fusion/failure_cause.hpp"

#include <gtest/gtest.h>

#include "gastronaut/magnetic_pose_t.hpp"

namespace gastronaut::fusion {
namespace {

PictureQuality picture(double sharpness, double highlights = 0, const char* failure = "") {
  return {failure, sharpness, highlights};
}

TEST(VisualCause, SaysWhatThePictureSaysOfItself) {
  const std::pair<const char*, const char*> words[] = {
      {"veiled", "blur"},       {"black", "dark"},   {"unlit", "dark"},
      {"white", "overexposed"}, {"size", "corrupt"}, {"unexplained", "foreign light"},
      {"new word", "new word"}};
  for (const auto& [failure, cause] : words) {
    VisualCause visual;
    visual.add(picture(1, 0, failure));
    EXPECT_EQ(visual.describe(true), cause);
    EXPECT_EQ(visual.describe(false), cause);
  }
}

TEST(VisualCause, WithoutAPictureItIsLostOrBadlyHeld) {
  const VisualCause visual;
  EXPECT_EQ(visual.describe(true), "lost");
  EXPECT_EQ(visual.describe(false), "low texture");
}

TEST(VisualCause, ABlurredPictureIsMuchLessSharpThanUsual) {
  VisualCause visual;
  for (int i = 0; i < 100; ++i) visual.add(picture(2.0));
  visual.add(picture(1.9));
  EXPECT_EQ(visual.describe(true), "lost");
  // However long it lasts: blurred pictures are no standard.
  for (int i = 0; i < 100; ++i) visual.add(picture(0.5));
  EXPECT_EQ(visual.describe(true), "blur");
  visual.add(picture(2.0));
  EXPECT_EQ(visual.describe(true), "lost");
}

TEST(VisualCause, ManyHighlightsAreSpecular) {
  VisualCause visual;
  visual.add(picture(1, 0.4));
  EXPECT_EQ(visual.describe(true), "specular");
  visual.add(picture(1, 0.01));
  EXPECT_EQ(visual.describe(true), "lost");
}

TEST(MagneticCause, NamesEveryStatus) {
  EXPECT_EQ(magnetic_cause(magnetic_pose_t::STATUS_OK), "");
  EXPECT_EQ(magnetic_cause(magnetic_pose_t::STATUS_NO_FIX), "no fix");
  EXPECT_EQ(magnetic_cause(magnetic_pose_t::STATUS_TOO_FAR), "too far");
  EXPECT_EQ(magnetic_cause(magnetic_pose_t::STATUS_INTERFERENCE), "interference");
  EXPECT_EQ(magnetic_cause(magnetic_pose_t::STATUS_SATURATED), "saturated");
  EXPECT_EQ(magnetic_cause(magnetic_pose_t::STATUS_NO_CURRENTS), "no coil currents");
  EXPECT_FALSE(magnetic_cause(99).empty());
}

}  // namespace
}  // namespace gastronaut::fusion
