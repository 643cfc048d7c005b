// What systemd wants to hear from a service of Type=notify (sd_notify(3)), so that it sees when one
// hangs. A datagram to $NOTIFY_SOCKET is all of it: no library is needed.
#pragma once

#include <string>

namespace gastronaut {

// `assignments`: lines like READY=1, WATCHDOG=1, STATUS=text. Does nothing where nobody listens.
void notify_service_manager(const std::string& assignments);

}  // namespace gastronaut
