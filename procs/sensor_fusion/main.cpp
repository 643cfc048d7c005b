#include "sensor_fusion/sensor_fusion_process.hpp"

int main(int argc, char** argv) {
  return gastronaut::run_process(argc, argv, gastronaut::sensor_fusion_process());
}
