// The command line of can_hall_array: a CAN interface or a recorded CAN log, live over LCM or into
// an LCM log.
#pragma once

namespace gastronaut {

// Returns the exit status.
int run_can_hall_array(int argc, char** argv);

}  // namespace gastronaut
