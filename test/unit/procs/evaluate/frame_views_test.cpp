#include "evaluate/frame_views.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gastronaut::evaluation {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

TEST(ChooseFramesTest, SpreadsAFewEvenly) {
  std::vector<std::string> notes;
  EXPECT_THAT(choose_frames(600, {}, notes), ElementsAre(50, 150, 250, 350, 450, 550));
  EXPECT_THAT(choose_frames(2, {}, notes), ElementsAre(0, 1));
  EXPECT_THAT(choose_frames(0, {}, notes), IsEmpty());
  EXPECT_THAT(notes, IsEmpty());
}

TEST(ChooseFramesTest, SaysWhichFrameDoesNotExist) {
  std::vector<std::string> notes;
  EXPECT_THAT(choose_frames(10, {7, 10, 3, 7}, notes), ElementsAre(3, 7));
  EXPECT_THAT(notes, ElementsAre(HasSubstr("no frame 10")));
}

}  // namespace
}  // namespace gastronaut::evaluation
