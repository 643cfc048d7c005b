#include "can/can_frame.hpp"

#include <gtest/gtest.h>

#include <set>

namespace gastronaut {
namespace {

// ISO 11898-1: data length codes 0 to 15.
const std::set<std::size_t> kLengths = {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};

TEST(CanFrame, DataGetsTheShortestLengthThatHoldsIt) {
  for (std::size_t bytes = 0; bytes <= kMostCanBytes; ++bytes) {
    EXPECT_EQ(can_frame_length(bytes), *kLengths.lower_bound(bytes)) << bytes;
  }
}

}  // namespace
}  // namespace gastronaut
