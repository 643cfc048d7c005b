#include "can/dbc.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <numbers>
#include <sstream>

#include "can/candump.hpp"
#include "configuration/fields.hpp"

namespace gastronaut {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

const std::string kConfig = std::string(GASTRONAUT_SOURCE_DIR) + "/config/";

std::string message_with(const std::string& signals) {
  return "VERSION \"\"\n\nBO_ 100 BOARD: 8 NODE\n" + signals;
}

std::string error_of(const std::string& text) {
  try {
    parse_dbc(text, "array.dbc");
  } catch (const ConfigurationError& error) {
    return error.what();
  }
  return "no error";
}

DbcSignal signal(const std::string& description) {
  return parse_dbc(message_with(" SG_ s : " + description + " [0|0] \"\" X\n"), "array.dbc")
      .at(0)
      .signals.at(0);
}

std::vector<std::uint8_t> bytes(const std::string& hexadecimal) {
  std::vector<std::uint8_t> data;
  for (std::size_t at = 0; at + 1 < hexadecimal.size(); at += 2) {
    data.push_back(static_cast<std::uint8_t>(std::stoi(hexadecimal.substr(at, 2), nullptr, 16)));
  }
  return data;
}

// Decimal fractions that are no binary ones: a value is exact to its last digit.
constexpr double kRounding = 1e-12;

// The example of cantools' documentation and tests, and what cantools makes of it.
TEST(Dbc, BigEndianSignalsAreWhatCantoolsMakesOfThem) {
  const DbcSignal enable = signal("7|1@0+ (1,0)");
  const DbcSignal radius = signal("6|6@0+ (0.1,0)");
  const DbcSignal temperature = signal("0|12@0- (0.01,250)");
  struct Case {
    const char* data;
    double enable, radius, temperature;
  };
  for (const Case& peer :
       {Case{"C006E00000000000", 1, 3.2, 250.55}, Case{"804A0F0000000000", 1, 0.0, 255.92}}) {
    const std::vector<std::uint8_t> data = bytes(peer.data);
    EXPECT_EQ(enable.value(data), peer.enable);
    EXPECT_NEAR(radius.value(data), peer.radius, kRounding);
    EXPECT_NEAR(temperature.value(data), peer.temperature, kRounding * peer.temperature);
  }
  std::vector<std::uint8_t> data(8);
  enable.set_value(data, 1);
  radius.set_value(data, 3.2);
  temperature.set_value(data, 250.55);
  EXPECT_EQ(data, bytes("C006E00000000000"));
}

// candied_values.csv: what another project's reader makes of config/hall_array.dbc.
TEST(Dbc, LittleEndianSignalsAreWhatCandiedMakesOfThem) {
  std::map<std::pair<std::uint32_t, std::string>, DbcSignal> signals;
  for (const DbcMessage& message : load_dbc(kConfig + "hall_array.dbc")) {
    for (const DbcSignal& s : message.signals) signals[{message.id, s.name}] = s;
  }
  std::ifstream file(std::string(GASTRONAUT_SOURCE_DIR) +
                     "/test/unit/common/can/candied_values.csv");
  int compared = 0;
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with('#')) continue;
    std::istringstream fields(line);
    std::string id, data, name, counts;
    std::getline(fields, id, ',');
    std::getline(fields, data, ',');
    std::getline(fields, name, ',');
    std::getline(fields, counts, ',');
    const DbcSignal& s = signals.at({static_cast<std::uint32_t>(std::stoul(id)), name});
    EXPECT_EQ(s.value(bytes(data)), std::stod(counts) * s.factor) << line;
    ++compared;
  }
  constexpr int kInTheFile = 76;
  EXPECT_EQ(compared, kInTheFile);
}

TEST(Dbc, EveryBitOfASignalGoesWhereItsPlacesSay) {
  for (const char* description : {"0|8@1+ (1,0)", "5|17@1- (1,0)", "7|16@0+ (1,0)",
                                  "11|17@0- (1,0)", "0|64@1- (1,0)", "7|64@0+ (1,0)"}) {
    const DbcSignal s = signal(description);
    const std::vector<int> places = s.bit_places();
    ASSERT_EQ(static_cast<int>(places.size()), s.num_bits);
    for (int bit = 0; bit < s.num_bits; ++bit) {
      std::array<std::uint8_t, 8> data{};
      s.set_counts(data, std::uint64_t{1} << bit);
      const int place = places[static_cast<std::size_t>(bit)];
      std::array<std::uint8_t, 8> expected{};
      expected[static_cast<std::size_t>(place / 8)] = static_cast<std::uint8_t>(1 << place % 8);
      EXPECT_EQ(data, expected) << description << " bit " << bit;
      EXPECT_EQ(s.counts(data), std::uint64_t{1} << bit) << description;
    }
  }
}

TEST(Dbc, CountsSurviveTheirValueAndLeaveOtherBitsAlone) {
  const DbcSignal s = signal("11|17@0- (0.0000002,0)");  // the converter's counts of 0.2 uT
  for (int counts = -65536; counts < 65536; counts += 111) {
    std::array<std::uint8_t, 8> data;
    data.fill(0xA5);
    s.set_value(data, counts * 2e-7);
    EXPECT_EQ(s.value(data), counts * 2e-7);
    std::array<std::uint8_t, 8> cleared;
    cleared.fill(0xA5);
    s.set_counts(cleared, 0);
    s.set_counts(data, 0);
    EXPECT_EQ(data, cleared);
  }
}

TEST(Dbc, ValuesBeyondASignalsRangeBecomeItsEnds) {
  const double infinity = std::numeric_limits<double>::infinity();
  std::array<std::uint8_t, 8> data{};
  const auto set = [&](const char* description, double value) {
    const DbcSignal s = signal(description);
    s.set_value(data, value);
    return s.value(data);
  };
  EXPECT_EQ(set("0|8@1+ (1,0)", 300), 255);
  EXPECT_EQ(set("0|8@1+ (1,0)", -1), 0);
  EXPECT_EQ(set("0|8@1- (1,0)", 300), 127);
  EXPECT_EQ(set("0|8@1- (1,0)", -300), -128);
  EXPECT_EQ(set("0|8@1- (2,10)", -infinity), -246);
  EXPECT_EQ(set("0|64@1- (1,0)", infinity), 9223372036854775807.0);
  EXPECT_EQ(set("0|64@1- (1,0)", -infinity), -9223372036854775808.0);
}

TEST(Dbc, FloatingPointSignalsCarryTheirNumberExactly) {
  const std::string text = message_with(
                               " SG_ a : 0|32@1- (1,0) [0|0] \"A\" X\n"
                               " SG_ b : 39|32@0- (1,0) [0|0] \"A\" X\n") +
                           "SIG_VALTYPE_ 100 a : 1;\nSIG_VALTYPE_ 100 b : 1;\n";
  const DbcMessage message = parse_dbc(text, "array.dbc").at(0);
  std::array<std::uint8_t, 8> data{};
  const float number = std::numbers::pi_v<float>;
  for (const DbcSignal& s : message.signals) s.set_value(data, -number);
  for (const DbcSignal& s : message.signals) EXPECT_EQ(s.value(data), -number);
  EXPECT_THAT(data, ElementsAre(0xDB, 0x0F, 0x49, 0xC0, 0xC0, 0x49, 0x0F, 0xDB));  // IEEE 754
}

TEST(Dbc, MultiplexingExtendedIdentifiersAndSkippedStatementsAreUnderstood) {
  const std::vector<DbcMessage> messages = parse_dbc(
      "VERSION \"1\"\nNS_ :\n\tCM_\n\tSIG_VALTYPE_\n\tSG_MUL_VAL_\nBS_:\nBU_: A B\n"
      "VAL_TABLE_ t 1 \"one\" 0 \"none\" ;\n"
      "BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n"
      " SG_ orphan : 0|8@1+ (1,0) [0|0] \"\" Vector__XXX\n"
      "BO_ 2147484672 FAR: 3 A\n"
      " SG_ which M : 0|4@1+ (1,0) [0|0] \"\" B\n"
      "SG_ first m0 : 8|16@1- (-1.5e-3,+.5) [-1|1] \"mA\" B,A\n"
      " SG_ second m11 : 8|16@1- (1,0) [0|0] \"mA\" B\n"
      "BO_TX_BU_ 2147484672 : A,B;\nEV_ e: 0 [0|1] \"\" 0 1 DUMMY_NODE_VECTOR0 A;\n"
      "CM_ SG_ 2147484672 first \"a comment\nBO_ 7 over lines; with \\\"quotes\\\"\";\n"
      "BA_DEF_ BO_ \"x\" INT 0 1;\nBA_ \"x\" BO_ 2147484672 1;\n"
      "VAL_ 2147484672 which 0 \"a\" 1 \"b\" ;\nSIG_GROUP_ 2147484672 g 1 : first;\r\n",
      "array.dbc");
  ASSERT_EQ(messages.size(), 1U);
  EXPECT_EQ(messages[0].id, 1024U);
  EXPECT_TRUE(messages[0].extended);
  EXPECT_EQ(messages[0].length, 3);
  ASSERT_EQ(messages[0].signals.size(), 3U);
  EXPECT_EQ(messages[0].multiplexor(), &messages[0].signals[0]);
  EXPECT_EQ(messages[0].signals[1].multiplex, 0U);
  EXPECT_EQ(messages[0].signals[2].multiplex, 11U);
  EXPECT_EQ(messages[0].signals[1].factor, -1.5e-3);
  EXPECT_EQ(messages[0].signals[1].offset, 0.5);
  EXPECT_EQ(messages[0].signals[1].unit, "mA");
  EXPECT_EQ(messages[0].signals[1].line, 13);
}

TEST(Dbc, MistakesAreNamedWithFileAndLine) {
  const auto in_signal = [](const std::string& s) { return error_of(message_with(s + "\n")); };
  EXPECT_THAT(in_signal(" SG_ s : 60|8@1+ (1,0) [0|0] \"\" X"),
              AllOf(HasSubstr("array.dbc:4: "), HasSubstr("within the 8 bytes of BOARD")));
  EXPECT_THAT(in_signal(" SG_ s : 0|16@0+ (1,0) [0|0] \"\" X"), "no error");  // 0, then 15 to 8...
  EXPECT_THAT(in_signal(" SG_ s : 56|16@0+ (1,0) [0|0] \"\" X"), HasSubstr("within"));
  EXPECT_THAT(in_signal(" SG_ s : 0|65@1+ (1,0) [0|0] \"\" X"), HasSubstr("1 to 64 bits"));
  EXPECT_THAT(in_signal(" SG_ s : 0|8@2+ (1,0) [0|0] \"\" X"), HasSubstr("byte order"));
  EXPECT_THAT(in_signal(" SG_ s : 0|8@1 (1,0) [0|0] \"\" X"), HasSubstr("+ (unsigned)"));
  EXPECT_THAT(in_signal(" SG_ s : 0|8@1+ (0,0) [0|0] \"\" X"), HasSubstr("factor of 0"));
  EXPECT_THAT(in_signal(" SG_ s : 0|8@1+ (1e999,0) [0|0] \"\" X"), HasSubstr("the factor"));
  EXPECT_THAT(in_signal(" SG_ s : 0|8@1+ (1 0) [0|0] \"\" X"), HasSubstr("expected ','"));
  EXPECT_THAT(in_signal(" SG_ s : 0|8@1+ (1,0) [0|0] X"), HasSubstr("the unit in quotes"));
  EXPECT_THAT(in_signal(" SG_ s : 0|8@1+ (1,0) [0|0] \"T"), HasSubstr("without its end"));
  EXPECT_THAT(in_signal(" SG_ s m1M : 0|8@1+ (1,0) [0|0] \"\" X"), HasSubstr("extended"));
  EXPECT_THAT(in_signal(" SG_ s m1 : 0|8@1+ (1,0) [0|0] \"\" X"), HasSubstr("no multiplexor"));
  EXPECT_THAT(in_signal(" SG_ s : 0|8@1+ (1,0) [0|0] \"\" X\n SG_ s : 8|8@1+ (1,0) [0|0] \"\" X"),
              AllOf(HasSubstr("array.dbc:5: "), HasSubstr("two signals s")));
  EXPECT_THAT(
      in_signal(" SG_ w M : 0|2@1+ (1,0) [0|0] \"\" X\n SG_ s m4 : 8|8@1+ (1,0) [0|0] \"\" X"),
      HasSubstr("w is never 4"));
  EXPECT_THAT(error_of(" SG_ s : 0|8@1+ (1,0) [0|0] \"\" X\n"), HasSubstr("before the first"));
  EXPECT_THAT(error_of("BO_ 2048 A: 8 X\n"), HasSubstr("no CAN identifier 2048"));
  EXPECT_THAT(error_of("BO_ 1 A: 65 X\n"), HasSubstr("0 to 64 bytes"));
  EXPECT_THAT(error_of("BO_ 1 A: 8 X\nBO_ 1 B: 8 X\n"),
              AllOf(HasSubstr("array.dbc:2: "), HasSubstr("another message")));
  EXPECT_THAT(error_of("BO_ x\n"), HasSubstr("message's identifier instead of 'x'"));
  EXPECT_THROW(load_dbc("/no/such.dbc"), ConfigurationError);
}

std::filesystem::path shared_logs() {
  const char* data = std::getenv("GASTRONAUT_DATA");
  return std::filesystem::path(data != nullptr ? data : GASTRONAUT_SOURCE_DIR "/../shared/data") /
         "can_logs";
}

// A car's database, written by people, and what its bus carried: a flag and a number of the other
// byte order tell of the same pedal.
TEST(Dbc, ARealDatabaseReadsARealLog) {
  const std::filesystem::path folder = shared_logs() / "ElDominio/Yaris 09";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no " << folder;
  const std::vector<DbcMessage> messages = load_dbc((folder / "toyota_iQ_2009_can.dbc").string());
  constexpr std::size_t kMessages = 26;  // lines beginning with BO_
  EXPECT_EQ(messages.size(), kMessages);
  const auto command = std::find_if(messages.begin(), messages.end(),
                                    [](const DbcMessage& m) { return m.name == "COMMAND"; });
  ASSERT_NE(command, messages.end());
  std::map<std::string, DbcSignal> signals;
  for (const DbcSignal& s : command->signals) signals[s.name] = s;
  std::ifstream log(folder / "accellog.log");
  std::array<double, 2> sum{};
  std::array<int, 2> count{};
  for (std::string line; std::getline(log, line);) {
    const CanFrame frame = parse_candump_line(line).frame;
    if (frame.id != command->id) continue;
    const bool released = signals.at("NOT_ACCELERATING_PEDAL").value(frame.bytes()) != 0;
    sum[released ? 1 : 0] += signals.at("ACC_PEDAL_MEAN").value(frame.bytes());
    ++count[released ? 1 : 0];
  }
  ASSERT_GT(count[0], 10);
  ASSERT_GT(count[1], 10);
  // Bytes in the wrong order would be noise, the same for both.
  constexpr double kTimesAsMuch = 5;
  EXPECT_GT(sum[0] / count[0], kTimesAsMuch * sum[1] / count[1]);
}

}  // namespace
}  // namespace gastronaut
