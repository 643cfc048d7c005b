#include "uvc_camera/run_uvc_camera_process.hpp"

int main(int argc, char** argv) { return gastronaut::run_uvc_camera(argc, argv); }
