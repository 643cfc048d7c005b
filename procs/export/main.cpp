#include "export/export_program.hpp"

int main(int argc, char** argv) { return gastronaut::run_export(argc, argv); }
