// The command line of export.
#pragma once

namespace gastronaut {

// export LOG --out FOLDER [--only KIND,...]. Returns the exit status: 0 done, 1 failed while
// running, 2 wrong usage.
int run_export(int argc, char** argv);

}  // namespace gastronaut
