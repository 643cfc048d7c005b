// Every process in one program over a log, as fast as it goes, into one derived log. The same log
// gives the same bytes, whatever the number of threads.
#pragma once

#include <string>
#include <vector>

#include "process/process.hpp"

namespace gastronaut {

// All processes in the order of the flow, upstream first.
std::vector<ProcessDescription> all_processes();

// Those whose names stand in the comma-separated `only`, in the order of the flow; all when it is
// empty. Throws ConfigurationError for a name that is none.
std::vector<ProcessDescription> select_processes(const std::string& only);

// The program. Returns the exit status.
int run_replay(int argc, char** argv);

}  // namespace gastronaut
