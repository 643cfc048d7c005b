#pragma once

namespace gastronaut {

// Version and git description of this build, as --version prints it and RIG_CONFIG carries it.
const char* code_version();

}  // namespace gastronaut
