// The program: scores a derived log, or one trajectory file against another.
#pragma once

namespace gastronaut {

// Returns the exit status.
int run_evaluate(int argc, char** argv);

}  // namespace gastronaut
