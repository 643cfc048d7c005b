// The command line of virtual_rig: a scenario into a log, or live over LCM.
#pragma once

namespace gastronaut {

// Returns the exit status.
int run_virtual_rig(int argc, char** argv);

}  // namespace gastronaut
