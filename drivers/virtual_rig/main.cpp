#include "virtual_rig/run_virtual_rig_process.hpp"

int main(int argc, char** argv) { return gastronaut::run_virtual_rig(argc, argv); }
