// Preloaded into user-mode Linux 6.1, which sets a process's floating-point registers from a buffer
// of fixed size. Kernels refuse that where the processor's state is larger (AMX): here the rest of
// the state is taken as it is and written back with what user-mode Linux wants set.
//
// Nothing large on the stack: the guest kernel's are small. Static buffers serve, the guest has one
// processor.
#include <elf.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdarg>
#include <cstdint>
#include <cstring>

namespace {

constexpr std::size_t kLargestState = 65536;  // bytes; AMX needs 11008
alignas(64) std::array<std::uint8_t, kLargestState> state;

}  // namespace

extern "C" long ptrace(enum __ptrace_request request, ...) noexcept {
  va_list arguments;
  va_start(arguments, request);
  const auto process = va_arg(arguments, int);
  void* const address = va_arg(arguments, void*);
  void* const data = va_arg(arguments, void*);
  va_end(arguments);
  if (request == PTRACE_SETREGSET && reinterpret_cast<std::uintptr_t>(address) == NT_X86_XSTATE) {
    iovec whole{state.data(), state.size()};
    const long failed = syscall(SYS_ptrace, PTRACE_GETREGSET, process, address, &whole);
    if (failed != 0) return failed;
    const auto* wanted = static_cast<const iovec*>(data);
    std::memcpy(state.data(), wanted->iov_base, std::min(wanted->iov_len, whole.iov_len));
    return syscall(SYS_ptrace, PTRACE_SETREGSET, process, address, &whole);
  }
  // The C library's ptrace returns what is peeked, the system call stores it.
  if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
    long peeked = 0;
    const long failed = syscall(SYS_ptrace, request, process, address, &peeked);
    return failed < 0 ? failed : peeked;
  }
  return syscall(SYS_ptrace, request, process, address, data);
}
