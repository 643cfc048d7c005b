// The command line of uvc_camera.
#pragma once

namespace gastronaut {

// Returns the exit status.
int run_uvc_camera(int argc, char** argv);

}  // namespace gastronaut
