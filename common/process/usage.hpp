// What this program has used of the machine so far.
#pragma once

#include <cstdint>

namespace gastronaut {

double cpu_seconds();  // user and system, all threads
std::int64_t resident_bytes();
std::int64_t peak_resident_bytes();

}  // namespace gastronaut
