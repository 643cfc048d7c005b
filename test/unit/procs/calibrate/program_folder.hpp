// A folder in which tests run the project's programs, gone afterwards.
#pragma once

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

namespace gastronaut {

class ProgramFolder : public testing::Test {
 protected:
  explicit ProgramFolder(const std::string& name)
      : folder_(testing::TempDir() + name + "_" + std::to_string(getpid())) {
    std::filesystem::create_directories(folder_);
  }
  ~ProgramFolder() override { std::filesystem::remove_all(folder_); }

  // Exit status of PROGRAM ARGUMENTS; what it said is in out.txt and err.txt.
  int run_program(const std::string& command) const {
    const std::string line = "cd '" + folder_ + "' && '" + GASTRONAUT_BINARY_DIR + "/bin/'" +
                             command + " >out.txt 2>err.txt";
    return WEXITSTATUS(std::system(line.c_str()));
  }
  std::string read(const std::string& name) const {
    std::ostringstream text;
    text << std::ifstream(folder_ + "/" + name).rdbuf();
    return text.str();
  }

  const std::string folder_;
};

}  // namespace gastronaut
