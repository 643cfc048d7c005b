#include "calibrate/calibrate_process.hpp"

int main(int argc, char** argv) { return gastronaut::run_calibrate(argc, argv); }
