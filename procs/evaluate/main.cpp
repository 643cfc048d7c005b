#include "evaluate/evaluate.hpp"

int main(int argc, char** argv) { return gastronaut::run_evaluate(argc, argv); }
