// make_seeds FOLDER: writes FOLDER/TARGET/N for every fuzz target and the list FOLDER/TARGET.list
// that libFuzzer reads.
#include <turbojpeg.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "bus/log_file.hpp"
#include "configuration/rig_configuration.hpp"
#include "message_types.hpp"
#include "unit/drivers/uvc_camera/played_camera.hpp"

namespace gastronaut {
namespace {

using Seed = std::string;

std::string as_text(const std::vector<std::uint8_t>& bytes) { return {bytes.begin(), bytes.end()}; }

// Small messages with something in their arrays.
void fill(image_t& message) {
  message.size = 4;
  message.data = {0xFF, 0xD8, 0xFF, 0xD9};
  message.nmetadata = 1;
  message.metadata.resize(1);
  message.metadata[0].key = "seq";
  message.metadata[0].n = 1;
  message.metadata[0].value = {'7'};
}
void fill(hall_array_t& message) {
  message.num_sensors = 2;
  message.num_axes = 3;
  message.field = {{1e-4F, 0, -1e-4F}, {0, 0, 3e-4F}};
  message.status = {0, 1};
}
void fill(coil_currents_t& message) {
  message.num_coils = 2;
  message.current = {1.5F, -2};
}
void fill(capsule_state_t& message) {
  message.num_sensors = 1;
  message.sensors.resize(1);
  message.sensors[0].name = "magnetic";
  message.sensors[0].cause = "too far";
}
void fill(rig_config_t& message) {
  message.name = "rig";
  message.yaml = "name: rig\n";
}
template <class Message>
void fill(Message&) {}

std::vector<Seed> wire_seeds() {
  std::vector<Seed> seeds;
  for (std::size_t type = 0; type < kMessageTypes; ++type) {
    visit_message_type(type, [&](auto message) {
      message = {};
      fill(message);
      constexpr std::size_t kFingerprint = 8;
      seeds.push_back(std::string(1, static_cast<char>(type)) +
                      as_text(encode_message(message)).substr(kFingerprint));
    });
  }
  return seeds;
}

std::string read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::vector<Seed> log_seeds(const std::string& folder) {
  const std::string path = folder + "/seed.lcmlog";
  LogWriter log(path);
  coil_currents_t currents{};
  fill(currents);
  rig_config_t configuration{};
  fill(configuration);
  log.write("RIG_CONFIG", configuration);
  log.write("COIL_CURRENTS", currents);
  log.close();
  return {read(path)};
}

std::vector<Seed> configuration_seeds() {
  using namespace std::string_literals;
  RigConfiguration rig;
  rig.hall_array.rows = 1;
  rig.hall_array.cols = 1;
  rig.hall_array.sensors.resize(1);
  rig.coils.tesla_per_ampere = Eigen::MatrixXd::Ones(3, 2);
  return {write_configuration(rig), write_configuration(RigConfiguration{}),
          "hall_array: {pitch: 22 mm, noise: 1.5 uT}\0camera.rate=30"s,
          "camera: {model: fisheye, distortion: [0.1, 0, 0, 0]}\0magnetic_localizer.estimator="
          "second_difference"s};
}

std::vector<Seed> table_seeds() {
  const auto columns = [](char count) { return std::string(1, static_cast<char>(count - 1)); };
  return {columns(3) + "time,x,y\n0,1.5,-2e-3\n0.01,+2,3\r\n# pause\n0.02,x,1\n",
          columns(8) + "# time tx ty tz qx qy qz qw\n0.5 1 2 3 0 0 0.6 0.8\n0.6 1 2 3 0 0 0 1\n",
          columns(12) + "1 0 0 0 0 1 0 0 0 0 1 0\n0 -1 0 1 1 0 0 2 0 0 1 3\n",
          columns(4) +
              "0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 1 2\n0 -1 0 1\n1 0 0 2\n0 0 1 "
              "3\n0 0 0 1\n"};
}

// A CAN database of two sensors, then a log of its frames after a zero byte.
std::vector<Seed> can_seeds() {
  using namespace std::string_literals;
  const Seed log =
      "(1.000100) can0 00A#01000200FDFF0400\n(1.000200) can0 00B#0110002000300040\n"
      "(1.005100) can0 00A#02000200FDFF0400\n(1.010100) can0 00B#0310002000300040\n"
      "(1.5) can0 123##1AABBCCDD\n(2.0) can0 20000040#0000000000000000\n(2.1) can0 123#R8\n";
  const auto message = [](int number, bool little_endian) {
    std::string text = "BO_ " + std::to_string(10 + number) + " M" + std::to_string(number) +
                       ": 8 X\n SG_ cycle : 0|8@1+ (1,0) [0|255] \"\" X\n";
    for (int axis = 0; axis < 3; ++axis) {
      text += " SG_ sensor" + std::to_string(number) + "_" + "xyz"[axis] + " : " +
              std::to_string(little_endian ? 8 + 16 * axis : 15 + 16 * axis) +
              (little_endian ? "|16@1-" : "|16@0-") + " (0.2,0) [0|0] \"uT\" X\n";
    }
    return text;
  };
  return {"VERSION \"\"\nNS_ :\n\tCM_\nBU_: X\n" + message(0, true) + message(1, false) +
              "CM_ \"words\";\n" + "\0"s + log,
          "BO_ 12 C: 8 X\n SG_ cycle : 0|8@1+ (1,0) [0|255] \"\" X\n"
          " SG_ w M : 8|8@1+ (1,0) [0|0] \"\" X\n"
          " SG_ coil0_current m0 : 16|32@1- (1,0) [0|0] \"A\" X\n"
          "SIG_VALTYPE_ 12 coil0_current : 1;\n"s};
}

// Descriptors of a camera (0), and two of its pictures as payloads with a byte of length before
// each: in transfers of bulk (1) and in packets (2).
std::vector<Seed> uvc_seeds() {
  const auto text = [](int kind, const Octets& bytes) {
    return std::string(1, static_cast<char>(kind)) + std::string(bytes.begin(), bytes.end());
  };
  std::vector<Seed> seeds;
  for (const bool is_isochronous : {true, false}) {
    PlayedCamera camera(is_isochronous);
    seeds.push_back(text(0, camera.configuration_descriptor()));
    Octets payloads;
    for (const std::uint32_t time : {0u, 33'333u}) {
      for (const Octets& payload : camera.payloads(Octets(100, 7), time, time + 9000, {})) {
        payloads.push_back(static_cast<std::uint8_t>(payload.size()));
        payloads.insert(payloads.end(), payload.begin(), payload.end());
      }
    }
    seeds.push_back(text(is_isochronous ? 2 : 1, payloads));
  }
  return seeds;
}

void write(const std::string& folder, const std::string& target, const std::vector<Seed>& seeds) {
  const std::string seeds_folder = folder + "/" + target;
  std::filesystem::create_directories(seeds_folder);
  std::string list;
  for (std::size_t i = 0; i < seeds.size(); ++i) {
    const std::string path = seeds_folder + "/" + std::to_string(i);
    std::ofstream(path, std::ios::binary) << seeds[i];
    list += (i == 0 ? "" : ",") + path;
  }
  std::ofstream(folder + "/" + target + ".list") << list;
}

}  // namespace
}  // namespace gastronaut

// Five bytes of format, sizes, stride and gain (see picture_fuzz.cpp), then a picture of 32 x 24.
std::vector<std::string> pictures() {
  constexpr int kWidth = 32;
  constexpr int kHeight = 24;
  std::string rgb;
  for (int i = 0; i < kWidth * kHeight; ++i) {
    rgb += {static_cast<char>(150 + i % 50), static_cast<char>(90 + i % 40), '\x50'};
  }
  const tjhandle compressor = tjInitCompress();
  unsigned char* buffer = nullptr;
  unsigned long size = 0;
  constexpr int kQuality = 85;
  tjCompress2(compressor, reinterpret_cast<const unsigned char*>(rgb.data()), kWidth, 0, kHeight,
              TJPF_RGB, &buffer, &size, TJSAMP_420, kQuality, 0);
  const std::string jpeg(reinterpret_cast<const char*>(buffer), size);
  tjFree(buffer);
  tjDestroy(compressor);
  const std::string mjpeg_header("\0\1\1\1\x80", 5);
  const std::string rgb_header("\2\1\1\1\x80", 5);
  return {mjpeg_header + jpeg, mjpeg_header + jpeg.substr(0, jpeg.size() / 2), rgb_header + rgb};
}

int main(int argc, char** argv) {
  using namespace gastronaut;
  if (argc != 2) return 2;
  const std::string folder = argv[1];
  std::filesystem::create_directories(folder);
  write(folder, "wire", wire_seeds());
  write(folder, "log_reader", log_seeds(folder));
  write(folder, "configuration", configuration_seeds());
  write(folder, "import_table", table_seeds());
  write(folder, "can", can_seeds());
  write(folder, "uvc", uvc_seeds());
  // Sequences of numbers for the targets that read numbers.
  std::string numbers;
  for (int i = 0; i < 256; ++i) numbers.push_back(static_cast<char>(i * 37));
  write(folder, "camera_model", {numbers});
  write(folder, "event_order", {numbers});
  write(folder, "picture", pictures());
}
