#include "surfels/surfel_store.hpp"

#include <gtest/gtest.h>

#include <limits>

namespace gastronaut {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

constexpr float kStableConfidence = 4;

Surfel surfel(float x, float confidence = 2 * kStableConfidence) {
  return {{x, 0, 0}, {0, 0, 1}, {1, 2, 3}, 0.001F, confidence};
}

TEST(SurfelStore, HoldsWhatWasSaidLast) {
  SurfelStore store;
  EXPECT_TRUE(store.set(7, surfel(1)));
  EXPECT_TRUE(store.set(3, surfel(2, kStableConfidence)));
  EXPECT_TRUE(store.set(5, surfel(3, kStableConfidence / 2)));
  EXPECT_EQ(store.stable(kStableConfidence), 2U);
  EXPECT_TRUE(store.set(7, surfel(4, 0)));
  EXPECT_EQ(store.size(), 3U);
  EXPECT_EQ(store.stable(kStableConfidence), 1U);
  store.remove(3);
  store.remove(3);
  store.remove(99);
  EXPECT_EQ(store.stable(kStableConfidence), 0U);
  const std::vector<Surfel> list = store.list();
  ASSERT_EQ(list.size(), 2U);
  EXPECT_EQ(list[0].position.x(), 3);  // by id: 5, then 7
  EXPECT_EQ(list[1].position.x(), 4);
  store.reset();
  EXPECT_EQ(store.size(), 0U);
}

TEST(SurfelStore, RefusesWhatIsNoSurfel) {
  SurfelStore store;
  EXPECT_FALSE(store.set(-1, surfel(0)));
  EXPECT_FALSE(store.set(std::numeric_limits<std::int32_t>::min(), surfel(0)));
  EXPECT_FALSE(store.set(0, surfel(kNaN)));
  EXPECT_FALSE(store.set(0, surfel(1e30F)));
  EXPECT_FALSE(store.set(0, surfel(0, kNaN)));
  Surfel flat = surfel(0);
  flat.radius = 0;
  EXPECT_FALSE(store.set(0, flat));
  Surfel directionless = surfel(0);
  directionless.normal.setZero();
  EXPECT_FALSE(store.set(0, directionless));
  EXPECT_EQ(store.size(), 0U);
}

TEST(SurfelStore, KnowsWhenASurfelWasMeasuredLast) {
  const auto at = [](std::int64_t utime, float x, float confidence, std::uint8_t red) {
    Surfel result = surfel(x, confidence);
    result.colour[0] = red;
    result.measured_utime = utime;
    return result;
  };
  SurfelStore store;
  const auto measured = [&store] { return store.list().at(0).measured_utime; };
  store.set(7, at(10, 1, 5, 100));
  EXPECT_EQ(measured(), 10);
  store.set(7, at(20, 2, 5, 100));  // the map was bent
  EXPECT_EQ(measured(), 10);
  store.set(7, at(30, 2, 6, 100));
  EXPECT_EQ(measured(), 30);
  store.set(7, at(40, 2, 3, 100));  // doubted, not measured
  EXPECT_EQ(measured(), 30);
  store.set(7, at(50, 2, 3, 101));
  EXPECT_EQ(measured(), 50);
  store.reset();  // told again in another frame
  store.set(7, at(60, 3, 3, 101));
  EXPECT_EQ(measured(), 50);
  store.remove(7);
  store.set(7, at(70, 3, 3, 101));  // another surfel
  EXPECT_EQ(measured(), 70);
}

TEST(SurfelStore, AbsurdIdsCostNoMemory) {
  SurfelStore store;
  // An array by id would be some 80 gigabytes long.
  EXPECT_TRUE(store.set(std::numeric_limits<std::int32_t>::max(), surfel(1)));
  EXPECT_EQ(store.list().size(), 1U);
}

TEST(SurfelStore, NormalsBecomeUnit) {
  SurfelStore store;
  Surfel one = surfel(0);
  one.normal = {0, 0, -4};
  EXPECT_TRUE(store.set(0, one));
  EXPECT_EQ(store.list().front().normal, Eigen::Vector3f(0, 0, -1));
}

}  // namespace
}  // namespace gastronaut
