#include "occupancy_mapper/occupancy_mapper_process.hpp"

int main(int argc, char** argv) {
  return gastronaut::run_process(argc, argv, gastronaut::occupancy_mapper_process());
}
