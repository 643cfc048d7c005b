#include "import/table.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "import_fixtures.hpp"

namespace gastronaut {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST(Table, CommasAndBlanksSeparateAlike) {
  CollectedIssues collected;
  const Table commas = parse_table("0, 1.5,-2e-3\n1,2,3\n", 3, "a.csv", collected.issues);
  const Table blanks = parse_table("0 1.5\t-2e-3\r\n  1  2 3", 3, "a.txt", collected.issues);
  EXPECT_THAT(commas.values, ElementsAre(0, 1.5, -2e-3, 1, 2, 3));
  EXPECT_EQ(blanks.values, commas.values);
  EXPECT_EQ(collected.list.size(), 0U);
}

TEST(Table, HeaderCommentsEmptyLinesAndByteOrderMarkAreNoRows) {
  CollectedIssues collected;
  const Table table = parse_table("\xEF\xBB\xBFtime,current\n\n# pause\n0.5,+7\n", 2, "coils.csv",
                                  collected.issues);
  EXPECT_THAT(table.values, ElementsAre(0.5, 7));
  EXPECT_THAT(table.lines, ElementsAre(4U));
  EXPECT_EQ(collected.list.size(), 0U);
}

TEST(Table, BadRowsAreNamedByFileAndLineAndLeftOut) {
  CollectedIssues collected;
  const Table table =
      parse_table("0,1\n1\n2,x\n3,nan\n4,\n5,1e40\n6,7,8\n7,8\n", 2, "hall.csv", collected.issues);
  EXPECT_THAT(table.values, ElementsAre(0, 1, 7, 8));
  EXPECT_THAT(table.lines, ElementsAre(1U, 8U));
  EXPECT_THAT(collected.list, ElementsAre("hall.csv:2: 1 numbers instead of 2; row skipped",
                                          "hall.csv:3: 'x' is not a number; row skipped",
                                          "hall.csv:4: 'nan' is not a number; row skipped",
                                          "hall.csv:5: '' is not a number; row skipped",
                                          "hall.csv:6: '1e40' is not a number; row skipped",
                                          "hall.csv:7: 3 numbers instead of 2; row skipped"));
}

TEST(Table, TextWithoutRowsIsEmpty) {
  CollectedIssues collected;
  EXPECT_EQ(parse_table("", 2, "a", collected.issues).rows(), 0U);
  EXPECT_EQ(parse_table("\n\r\n#\n", 2, "a", collected.issues).rows(), 0U);
}

}  // namespace
}  // namespace gastronaut
