#include "can/can_socket.hpp"

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <linux/net_tstamp.h>
#include <net/if.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstring>

#include "bus/wall_clock.hpp"

namespace gastronaut {
namespace {

constexpr int kReceiveBuffer = 16 << 20;  // bytes: seconds of frames

std::int64_t microseconds(const timespec& time) {
  return static_cast<std::int64_t>(time.tv_sec) * 1'000'000 + time.tv_nsec / 1000;
}

template <class Value>
void set_option(int socket, int level, int option, const Value& value, const char* what) {
  if (setsockopt(socket, level, option, &value, sizeof value) == 0) return;
  throw std::runtime_error(std::string("this kernel cannot ") + what + ": " + std::strerror(errno));
}

}  // namespace

CanSocket::CanSocket(const std::string& interface,
                     const std::vector<std::pair<std::uint32_t, bool>>& identifiers)
    : interface_(interface) {
  socket_ = ::socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
  if (socket_ < 0) {
    throw std::runtime_error(std::string("this kernel has no CAN (") + std::strerror(errno) +
                             "); try: sudo modprobe can-raw");
  }
  try {
    const int on = 1;
    set_option(socket_, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, on, "receive CAN FD");
    std::vector<can_filter> filters;
    for (const auto& [id, extended] : identifiers) {
      filters.push_back({extended ? id | CAN_EFF_FLAG : id,
                         CAN_EFF_FLAG | CAN_RTR_FLAG | (extended ? CAN_EFF_MASK : CAN_SFF_MASK)});
    }
    if (filters.size() > CAN_RAW_FILTER_MAX) filters = {{0, 0}};  // everything: it is sorted later
    if (setsockopt(socket_, SOL_CAN_RAW, CAN_RAW_FILTER, filters.data(),
                   static_cast<socklen_t>(filters.size() * sizeof(can_filter))) != 0) {
      throw std::runtime_error(std::string("CAN filters are refused: ") + std::strerror(errno));
    }
    if (!identifiers.empty()) {
      const can_err_mask_t all_errors = CAN_ERR_MASK;
      set_option(socket_, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, all_errors, "report CAN errors");
      const int stamps = SOF_TIMESTAMPING_RX_SOFTWARE | SOF_TIMESTAMPING_SOFTWARE |
                         SOF_TIMESTAMPING_RX_HARDWARE | SOF_TIMESTAMPING_RAW_HARDWARE;
      set_option(socket_, SOL_SOCKET, SO_TIMESTAMPING, stamps, "tell when frames came");
      set_option(socket_, SOL_SOCKET, SO_RXQ_OVFL, on, "count lost frames");
      // Beyond the host's limit where we may, up to it where we may not.
      if (setsockopt(socket_, SOL_SOCKET, SO_RCVBUFFORCE, &kReceiveBuffer, sizeof kReceiveBuffer) !=
          0) {
        set_option(socket_, SOL_SOCKET, SO_RCVBUF, kReceiveBuffer, "buffer frames");
      }
    }
    ifreq request{};
    interface.copy(request.ifr_name, sizeof request.ifr_name - 1);
    sockaddr_can address{};
    address.can_family = AF_CAN;
    if (ioctl(socket_, SIOCGIFINDEX, &request) != 0) unavailable(ENODEV);
    address.can_ifindex = request.ifr_ifindex;
    if (ioctl(socket_, SIOCGIFFLAGS, &request) != 0) unavailable(ENODEV);
    if ((request.ifr_flags & IFF_UP) == 0) unavailable(ENETDOWN);
    if (bind(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
      unavailable(errno);
    }
    epoll_ = epoll_create1(EPOLL_CLOEXEC);
    epoll_event event{};
    event.events = EPOLLIN;
    if (epoll_ < 0 || epoll_ctl(epoll_, EPOLL_CTL_ADD, socket_, &event) != 0) {
      throw std::runtime_error(std::string("epoll: ") + std::strerror(errno));
    }
  } catch (...) {
    if (epoll_ >= 0) close(epoll_);
    close(socket_);
    throw;
  }
}

CanSocket::~CanSocket() {
  close(epoll_);
  close(socket_);
}

void CanSocket::unavailable(int error) const {
  if (error == ENETDOWN) {
    throw CanUnavailable(interface_ + " is down; bring it up: sudo ip link set " + interface_ +
                         " up type can bitrate 1000000 dbitrate 5000000 fd on");
  }
  if (error == ENODEV || error == ENXIO) {
    throw CanUnavailable("there is no CAN interface " + interface_ +
                         "; plug the adapter in, or choose: --set can_hall_array.interface=NAME");
  }
  throw CanUnavailable(interface_ + ": " + std::strerror(error));
}

void CanSocket::wait(double seconds) const {
  epoll_event event{};
  epoll_wait(epoll_, &event, 1, static_cast<int>(std::ceil(seconds * 1000)));
}

std::optional<CanSocket::Received> CanSocket::receive() {
  canfd_frame raw{};
  iovec data{&raw, sizeof raw};
  alignas(cmsghdr) std::array<char, 256> control{};
  msghdr message{};
  message.msg_iov = &data;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  ssize_t size = recvmsg(socket_, &message, 0);
  // When the interface goes away, the socket says so before it hands out what had come till then.
  if (size < 0 && errno != EAGAIN && errno != EINTR && broken_ == 0) {
    broken_ = errno;
    size = recvmsg(socket_, &message, 0);
  }
  if (size < 0) {
    if (broken_ != 0) unavailable(broken_);
    return std::nullopt;
  }
  Received received;
  CanFrame& frame = received.frame;
  frame.fd = size == static_cast<ssize_t>(CANFD_MTU);
  frame.error = (raw.can_id & CAN_ERR_FLAG) != 0;
  frame.extended = !frame.error && (raw.can_id & CAN_EFF_FLAG) != 0;
  frame.remote = !frame.error && (raw.can_id & CAN_RTR_FLAG) != 0;
  frame.bit_rate_switch = frame.fd && (raw.flags & CANFD_BRS) != 0;
  frame.id = raw.can_id & (frame.extended || frame.error ? CAN_EFF_MASK : CAN_SFF_MASK);
  const std::size_t most = frame.fd ? kMostCanBytes : kClassicCanBytes;
  frame.length = static_cast<std::uint8_t>(std::min<std::size_t>(raw.len, most));
  std::copy_n(raw.data, frame.length, frame.data.begin());
  for (cmsghdr* part = CMSG_FIRSTHDR(&message); part != nullptr;
       part = CMSG_NXTHDR(&message, part)) {
    if (part->cmsg_level != SOL_SOCKET) continue;
    if (part->cmsg_type == SO_TIMESTAMPING) {
      std::array<timespec, 3> times{};  // software, unused, hardware
      std::memcpy(times.data(), CMSG_DATA(part), sizeof times);
      frame.utime = microseconds(times[0]);
      if (microseconds(times[2]) != 0) received.device_utime = microseconds(times[2]);
    } else if (part->cmsg_type == SO_RXQ_OVFL) {
      std::uint32_t count = 0;
      std::memcpy(&count, CMSG_DATA(part), sizeof count);
      dropped_ += count - kernel_dropped_;
      kernel_dropped_ = count;
    }
  }
  if (frame.utime == 0) frame.utime = wall_utime();
  return received;
}

bool CanSocket::send(const CanFrame& frame) {
  canfd_frame raw{};
  raw.can_id = frame.id | (frame.extended ? CAN_EFF_FLAG : 0U) |
               (frame.remote ? CAN_RTR_FLAG : 0U) | (frame.error ? CAN_ERR_FLAG : 0U);
  raw.len = frame.length;
  raw.flags = frame.fd && frame.bit_rate_switch ? CANFD_BRS : 0;
  std::copy_n(frame.data.begin(), frame.length, raw.data);
  const std::size_t size = frame.fd ? CANFD_MTU : CAN_MTU;
  constexpr int kTries = 100;
  constexpr int kMillisecondsATry = 1;
  for (int attempt = 0; attempt < kTries; ++attempt) {
    if (write(socket_, &raw, size) == static_cast<ssize_t>(size)) return true;
    // ENOBUFS: the interface's queue is full, which poll does not tell of.
    if (errno != ENOBUFS && errno != EAGAIN && errno != EINTR) {
      if (errno == EINVAL && frame.fd) {
        throw std::runtime_error(interface_ + " takes no CAN FD frames; bring it up with: fd on " +
                                 "(a virtual one with: mtu 72)");
      }
      unavailable(errno);
    }
    pollfd nothing{-1, 0, 0};
    poll(&nothing, 1, kMillisecondsATry);
  }
  return false;
}

}  // namespace gastronaut
