#include "depth_estimator/depth_estimator_process.hpp"

int main(int argc, char** argv) {
  return gastronaut::run_process(argc, argv, gastronaut::depth_estimator_process());
}
