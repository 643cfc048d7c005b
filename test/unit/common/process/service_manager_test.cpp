#include "process/service_manager.hpp"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <string>

namespace gastronaut {
namespace {

class ServiceManagerTest : public testing::Test {
 protected:
  ~ServiceManagerTest() override {
    unsetenv("NOTIFY_SOCKET");
    std::filesystem::remove(path_);
  }
  std::string path_ =
      (std::filesystem::temp_directory_path() / ("notify_" + std::to_string(getpid()))).string();
};

TEST_F(ServiceManagerTest, SaysItInOneDatagram) {
  const int handle = socket(AF_UNIX, SOCK_DGRAM, 0);
  ASSERT_GE(handle, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  path_.copy(address.sun_path, sizeof(address.sun_path) - 1);
  ASSERT_EQ(bind(handle, reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0)
      << std::strerror(errno);
  setenv("NOTIFY_SOCKET", path_.c_str(), 1);
  const std::string said = "WATCHDOG=1\nSTATUS=running";
  notify_service_manager(said);
  std::array<char, 256> heard{};
  const ssize_t length = recv(handle, heard.data(), heard.size(), MSG_DONTWAIT);
  close(handle);
  ASSERT_EQ(length, static_cast<ssize_t>(said.size()));
  EXPECT_EQ(std::string(heard.data()), said);
}

TEST_F(ServiceManagerTest, NobodyListeningIsNoError) {
  unsetenv("NOTIFY_SOCKET");
  notify_service_manager("READY=1");
  setenv("NOTIFY_SOCKET", path_.c_str(), 1);  // no such socket
  notify_service_manager("READY=1");
}

}  // namespace
}  // namespace gastronaut
