// The command line of import.
#pragma once

namespace gastronaut {

// import capture|tum|video ... --out FILE. Progress and what is left out on stderr. Returns the
// exit status: 0 done, 1 failed while running, 2 wrong usage or configuration.
int run_import(int argc, char** argv);

}  // namespace gastronaut
