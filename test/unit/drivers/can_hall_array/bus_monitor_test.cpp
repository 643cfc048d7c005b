#include "can_hall_array/bus_monitor.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/can/error.h>

namespace gastronaut {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

CanFrame error(std::uint32_t classes, std::uint8_t controller = 0) {
  CanFrame frame;
  frame.error = true;
  frame.id = classes;
  frame.length = CAN_ERR_DLC;
  frame.data[1] = controller;
  return frame;
}

TEST(BusMonitor, StatesFollowTheControllers) {
  BusMonitor monitor;
  EXPECT_EQ(monitor.describe("can0"), "");
  monitor.handle(error(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_WARNING));
  EXPECT_EQ(monitor.state(), BusMonitor::State::kWarning);
  monitor.handle(error(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_PASSIVE));
  EXPECT_EQ(monitor.state(), BusMonitor::State::kPassive);
  monitor.heard();
  EXPECT_EQ(monitor.state(), BusMonitor::State::kPassive) << "a passive controller hears, too";
  EXPECT_THAT(monitor.describe("can0"), AllOf(HasSubstr("can0"), HasSubstr("error-passive")));
  monitor.handle(error(CAN_ERR_CRTL, CAN_ERR_CRTL_ACTIVE));
  EXPECT_EQ(monitor.state(), BusMonitor::State::kActive);
  EXPECT_EQ(monitor.counters().recoveries, 0);
}

TEST(BusMonitor, BusOffAndRecoveryAreCountedOnceEach) {
  BusMonitor monitor;
  monitor.handle(error(CAN_ERR_BUSOFF));
  monitor.handle(error(CAN_ERR_BUSOFF));
  EXPECT_EQ(monitor.state(), BusMonitor::State::kBusOff);
  EXPECT_THAT(monitor.describe("can7"),
              AllOf(HasSubstr("bus-off"), HasSubstr("sudo ip link set can7 down")));
  monitor.handle(error(CAN_ERR_RESTARTED));
  EXPECT_EQ(monitor.state(), BusMonitor::State::kActive);
  EXPECT_EQ(monitor.counters().bus_offs, 1);
  EXPECT_EQ(monitor.counters().recoveries, 1);
  monitor.handle(error(CAN_ERR_BUSOFF));
  monitor.heard();  // somebody restarted it without a word
  EXPECT_EQ(monitor.state(), BusMonitor::State::kActive);
  EXPECT_EQ(monitor.counters().recoveries, 2);
}

TEST(BusMonitor, DamagedAndLostFramesAreCounted) {
  BusMonitor monitor;
  monitor.handle(error(CAN_ERR_PROT | CAN_ERR_BUSERROR));
  monitor.handle(error(CAN_ERR_CRTL, CAN_ERR_CRTL_RX_OVERFLOW));
  monitor.handle(error(CAN_ERR_ACK));
  EXPECT_EQ(monitor.counters().error_frames, 3);
  EXPECT_EQ(monitor.counters().protocol_errors, 1);
  EXPECT_EQ(monitor.counters().overflows, 1);
  EXPECT_EQ(monitor.state(), BusMonitor::State::kActive);
}

}  // namespace
}  // namespace gastronaut
