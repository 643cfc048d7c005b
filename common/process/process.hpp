// What a process is: an object that is given a Bus and a configuration, subscribes in its
// constructor and from then on only answers events. The same object runs live, on a log, in replay
// and in tests.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "bus/bus.hpp"
#include "configuration/rig_configuration.hpp"

namespace CLI {
class App;
}

namespace gastronaut {

class Process {
 public:
  virtual ~Process() = default;
  // After the last event: publish what is still held back.
  virtual void finish() {}
};

struct ProcessDescription {
  std::string name;     // the folder's
  std::string summary;  // one sentence for --help
  // The channel whose messages its outputs are about. Where a log has none of them (pictures are
  // left out of most derived logs), the outputs that are in the log are kept.
  std::string source;
  // Channels it publishes under this configuration: on a log they replace the log's own.
  std::function<std::vector<std::string>(const RigConfiguration&)> outputs;
  std::function<std::unique_ptr<Process>(Bus&, const RigConfiguration&)> create;
  // What its own program's command line has besides the common options; none: nothing. The values
  // must be there before create is called.
  std::function<void(CLI::App&)> add_options;
};

// The command line of architecture.md, live or on a log: --config --set --lcm-url --log-in
// --log-out --threads --version --help. Returns the exit status: 0 done, 1 failed while running,
// 2 wrong usage or configuration.
int run_process(int argc, char** argv, const ProcessDescription& description);

}  // namespace gastronaut
