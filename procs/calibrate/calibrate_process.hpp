// The program `calibrate`: reads a log, runs one of the calibrations, writes a configuration
// fragment.
#pragma once

namespace gastronaut {

// The command line: calibrate coils|array|light LOG --out FILE.yaml. Returns the exit status.
int run_calibrate(int argc, char** argv);

}  // namespace gastronaut
