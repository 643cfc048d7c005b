#include "magnetic_localizer/magnetic_localizer_process.hpp"

int main(int argc, char** argv) {
  return gastronaut::run_process(argc, argv, gastronaut::magnetic_localizer_process());
}
