#include "bus/host_check.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>

namespace gastronaut {
namespace {

struct Address {
  std::string group = "239.255.76.67";  // LCM's defaults
  std::uint16_t port = 7667;
  int receive_buffer = 0;
};

Address parse(const std::string& url) {
  Address address;
  std::string rest = url.substr(std::strlen("udpm://"));
  const std::size_t query = rest.find('?');
  const std::string key = "recv_buf_size=";
  const std::size_t size = rest.find(key, query == std::string::npos ? rest.size() : query);
  if (size != std::string::npos) {
    const char* begin = rest.data() + size + key.size();
    std::from_chars(begin, rest.data() + rest.size(), address.receive_buffer);
  }
  rest = rest.substr(0, query);
  const std::size_t colon = rest.find(':');
  if (colon != std::string::npos) {
    std::from_chars(rest.data() + colon + 1, rest.data() + rest.size(), address.port);
  }
  if (colon != 0 && !rest.empty()) address.group = rest.substr(0, colon);
  return address;
}

}  // namespace

std::vector<std::string> check_host(const std::string& lcm_url) {
  if (!lcm_url.starts_with("udpm://")) return {};
  const Address address = parse(lcm_url);
  std::vector<std::string> problems;

  sockaddr_in group{};
  group.sin_family = AF_INET;
  group.sin_port = htons(address.port);
  if (inet_pton(AF_INET, address.group.c_str(), &group.sin_addr) != 1 ||
      !IN_MULTICAST(ntohl(group.sin_addr.s_addr))) {
    problems.push_back("'" + address.group + "' in the LCM URL is not a multicast address; " +
                       "the usual one is udpm://239.255.76.67:7667");
    return problems;
  }
  const int handle = socket(AF_INET, SOCK_DGRAM, 0);
  if (handle < 0) {
    problems.push_back(std::string("no UDP socket can be opened: ") + std::strerror(errno));
    return problems;
  }
  if (connect(handle, reinterpret_cast<const sockaddr*>(&group), sizeof(group)) != 0) {
    problems.push_back("this host has no route for multicast to " + address.group + " (" +
                       std::strerror(errno) +
                       "); with only the loopback interface, mend it with: "
                       "sudo ip link set lo multicast on && sudo ip route add 224.0.0.0/4 dev lo");
  }
  if (address.receive_buffer > 0) {
    int granted = 0;
    socklen_t length = sizeof(granted);
    setsockopt(handle, SOL_SOCKET, SO_RCVBUF, &address.receive_buffer,
               sizeof(address.receive_buffer));
    getsockopt(handle, SOL_SOCKET, SO_RCVBUF, &granted, &length);
    granted /= 2;  // Linux reports twice what it grants (socket(7))
    if (granted < address.receive_buffer) {
      problems.push_back("the kernel grants a receive buffer of " + std::to_string(granted) +
                         " bytes of the " + std::to_string(address.receive_buffer) +
                         " asked for, so pictures may be lost; mend it with: "
                         "sudo sysctl -w net.core.rmem_max=" +
                         std::to_string(address.receive_buffer));
    }
  }
  close(handle);
  return problems;
}

}  // namespace gastronaut
