// The program on recorded CAN logs.
#include <gmock/gmock.h>

#include <cmath>
#include <gastronaut/hall_array_t.hpp>
#include <gastronaut/rig_config_t.hpp>

#include "bus/log_file.hpp"
#include "can/candump.hpp"
#include "can/hall_array_layout.hpp"
#include "process/channels.hpp"
#include "unit/procs/calibrate/program_folder.hpp"

namespace gastronaut {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

const std::string kRig = GASTRONAUT_SOURCE_DIR "/config/rigs/lab.yaml";

class RunCanHallArray : public ProgramFolder {
 protected:
  RunCanHallArray() : ProgramFolder("run_can_hall_array") {}

  void write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ + "/" + name) << text;
  }
  // `readings` readings of one count in every channel, as candump writes them.
  static std::string candump(int readings) {
    const RigConfiguration rig = load_rig_configuration({kRig}, {});
    const HallArrayLayout layout = load_hall_array_layout(rig, {kRig});
    std::string text;
    for (int reading = 0; reading < readings; ++reading) {
      std::vector<double> values(layout.num_values(CanStream::kField), 2e-7);
      std::fill(values.begin() + static_cast<std::ptrdiff_t>(layout.status_place(0)), values.end(),
                0.0);
      for (CanFrame frame :
           layout.encode(CanStream::kField, static_cast<std::uint64_t>(reading), values)) {
        frame.utime = 1'700'000'000'000'000 + reading * 10'000;
        text += format_candump_line({"can0", frame}) + "\n";
      }
    }
    return text;
  }
};

TEST_F(RunCanHallArray, ARecordedCanLogBecomesALog) {
  write("bus.log", "\n(1.0) can0 damaged\n" + candump(3));
  ASSERT_EQ(
      run_program("can_hall_array --config " + kRig + " --candump bus.log --log-out raw.lcmlog"), 0)
      << read("err.txt");
  EXPECT_THAT(read("err.txt"), AllOf(HasSubstr("bus.log:2: "), HasSubstr("1 damaged lines"),
                                     HasSubstr("readings: 3 whole, 0 incomplete, 0 lost")));
  LogReader log(folder_ + "/raw.lcmlog");
  std::vector<std::string> channels;
  while (const auto event = log.next()) channels.push_back(event->channel);
  EXPECT_EQ(log.damage(), "");
  EXPECT_THAT(channels, ::testing::ElementsAre(channel::kRigConfig, channel::kHallArray,
                                               channel::kHallArray, channel::kHallArray));
}

TEST_F(RunCanHallArray, TwiceTheSameLogGivesTheSameBytes) {
  write("bus.log", candump(5));
  const std::string command = "can_hall_array --config " + kRig + " --candump bus.log --log-out ";
  ASSERT_EQ(run_program(command + "a.lcmlog"), 0);
  ASSERT_EQ(run_program(command + "b.lcmlog"), 0);
  EXPECT_EQ(read("a.lcmlog"), read("b.lcmlog"));
  EXPECT_FALSE(read("a.lcmlog").empty());
}

TEST_F(RunCanHallArray, WrongConfigurationIsRefusedWithStatusTwo) {
  write("bus.log", candump(1));
  EXPECT_EQ(run_program("can_hall_array --candump bus.log --log-out a.lcmlog"), 2);
  EXPECT_THAT(read("err.txt"), HasSubstr("--config FILE"));
  EXPECT_EQ(run_program("can_hall_array --config " + kRig +
                        " --set can_hall_array.dbc=none.dbc --candump bus.log --log-out a.lcmlog"),
            2);
  EXPECT_THAT(read("err.txt"), HasSubstr("none.dbc: the CAN database cannot be read"));
  EXPECT_EQ(run_program("can_hall_array --config " + kRig +
                        " --set hall_array.rows=9 --candump bus.log --log-out a.lcmlog"),
            2);
  EXPECT_THAT(read("err.txt"), HasSubstr("no signal sensor64_x"));
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/a.lcmlog"));
}

}  // namespace
}  // namespace gastronaut
