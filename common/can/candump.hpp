// CAN frames as text, one a line, as `candump -l` and `candump -L` of can-utils write them:
//   (1618787934.854636) can0 0C5#3000000030000000
//   (1618787934.854636) can0 123##1AABB             CAN FD, after ## one digit of flags
#pragma once

#include <string>
#include <string_view>

#include "can/can_frame.hpp"

namespace gastronaut {

struct CandumpLine {
  std::string interface;
  CanFrame frame;
};

// Throws std::invalid_argument, saying what is wrong, for anything else than such a line.
CandumpLine parse_candump_line(std::string_view line);

// As candump would have written it.
std::string format_candump_line(const CandumpLine& line);

}  // namespace gastronaut
