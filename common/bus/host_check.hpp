// What this host lacks for LCM over UDP multicast, in plain words, with the command that mends it.
#pragma once

#include <string>
#include <vector>

namespace gastronaut {

// One sentence a problem; empty when all is well or the URL is not udpm.
std::vector<std::string> check_host(const std::string& lcm_url);

}  // namespace gastronaut
