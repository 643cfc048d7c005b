#include "process/version.hpp"

namespace gastronaut {

const char* code_version() { return GASTRONAUT_CODE_VERSION; }

}  // namespace gastronaut
