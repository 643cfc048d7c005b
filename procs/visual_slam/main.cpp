#include "visual_slam/visual_slam_process.hpp"

int main(int argc, char** argv) {
  return gastronaut::run_process(argc, argv, gastronaut::visual_slam_process());
}
