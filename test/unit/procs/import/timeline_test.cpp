#include "import/timeline.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "import_fixtures.hpp"

namespace gastronaut {
namespace {

using testing::ElementsAre;

TEST(Timeline, UtimeIsTheNearestMicrosecond) {
  EXPECT_EQ(to_utime(0.05, 1'700'000'000), 1'700'000'000'050'000);
  EXPECT_EQ(to_utime(1305031229.528748, 0), 1305031229528748);
}

TEST(Timeline, AnyNumberOfATableIsATime) {
  EXPECT_GT(to_utime(1e30, 1e30), 0);
  EXPECT_LT(to_utime(-1e30, 0), 0);
}

TEST(Timeline, OneWildTimeCostsItselfOnly) {
  EXPECT_THAT(longest_ascending({10, 20, 9000, 30, 40, 5, 50}), ElementsAre(0, 1, 3, 4, 6));
}

TEST(Timeline, OfEqualTimesTheFirstStays) {
  EXPECT_THAT(longest_ascending({10, 20, 20, 20, 30}), ElementsAre(0, 1, 4));
}

TEST(Timeline, NothingStaysNothing) { EXPECT_TRUE(longest_ascending({}).empty()); }

TEST(Timeline, RowsThatGoBackInTimeAreReportedAndLeaveAGapInSeq) {
  CollectedIssues collected;
  const Table table =
      parse_table("0.00,1\n0.01,2\n0.02,3\n0.005,4\n0.03,5\n", 2, "coils.csv", collected.issues);
  const Series series = make_series(table, 0, "coils.csv", collected.issues);
  EXPECT_THAT(series.utimes, ElementsAre(0, 10'000, 20'000, 30'000));
  EXPECT_THAT(series.values, ElementsAre(1, 2, 3, 5));
  EXPECT_THAT(series.seqs, ElementsAre(0, 1, 2, 4));
  EXPECT_THAT(collected.list,
              ElementsAre("coils.csv:4: the time does not go forward here; skipped"));
}

}  // namespace
}  // namespace gastronaut
