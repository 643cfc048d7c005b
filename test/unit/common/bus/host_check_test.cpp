#include "bus/host_check.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gastronaut {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

TEST(HostCheck, SaysNothingOfOtherTransports) {
  EXPECT_THAT(check_host("tcpq://127.0.0.1:7700"), IsEmpty());
}

TEST(HostCheck, AddressThatIsNoMulticastIsNamed) {
  EXPECT_THAT(check_host("udpm://10.1.2.3:7667"), Contains(HasSubstr("10.1.2.3")));
}

TEST(HostCheck, BufferThatNoKernelGrantsIsReportedWithTheCommand) {
  EXPECT_THAT(check_host("udpm://239.255.76.67:7667?recv_buf_size=2000000000"),
              Contains(HasSubstr("sudo sysctl -w net.core.rmem_max=2000000000")));
}

}  // namespace
}  // namespace gastronaut
