#include "import/import_program.hpp"

int main(int argc, char** argv) { return gastronaut::run_import(argc, argv); }
