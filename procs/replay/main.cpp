#include "replay/replay.hpp"

int main(int argc, char** argv) { return gastronaut::run_replay(argc, argv); }
