// What needs no CAN interface; the rest is tested on a kernel that has some, in test/guest.
#include "can/can_socket.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gastronaut {
namespace {

using ::testing::AllOf;
using ::testing::AnyOf;
using ::testing::HasSubstr;

TEST(CanSocket, WhatIsMissingIsSaidTogetherWithItsRemedy) {
  try {
    CanSocket socket("nosuchcan0", {{0x200, false}});
    FAIL() << "there is no such interface";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), AnyOf(HasSubstr("sudo modprobe can-raw"),
                                    AllOf(HasSubstr("no CAN interface nosuchcan0"),
                                          HasSubstr("interface=NAME"))));
  }
}

}  // namespace
}  // namespace gastronaut
