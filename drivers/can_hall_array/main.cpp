#include "can_hall_array/run_can_hall_array_process.hpp"

int main(int argc, char** argv) { return gastronaut::run_can_hall_array(argc, argv); }
