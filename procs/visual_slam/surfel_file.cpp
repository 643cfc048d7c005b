#include "visual_slam/surfel_file.hpp"

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <system_error>
#include <vector>

#include "process/whole_file.hpp"

namespace gastronaut::slam {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr std::array<char, 8> kMagic = {'G', 'N', 'S', 'U', 'R', 'F', 'E', 'L'};
constexpr std::uint32_t kVersion = 3;

struct Header {
  std::array<char, 8> magic = kMagic;
  std::uint32_t version = kVersion;
  std::uint32_t viewpoints = 0;
  std::uint64_t count = 0;
  std::uint64_t checksum = 0;
};
static_assert(sizeof(Header) == 32);

constexpr std::uint64_t kChecksumStart = 0xCBF29CE484222325;  // FNV-1a, 64 bits

template <class Value>
std::uint64_t checksum_of(const std::vector<Value>& array, std::uint64_t sum) {
  constexpr std::uint64_t kPrime = 0x100000001B3;
  static_assert(sizeof(Value) % sizeof(std::uint32_t) == 0);
  const char* bytes = reinterpret_cast<const char*>(array.data());
  for (std::size_t k = 0; k < array.size() * sizeof(Value); k += sizeof(std::uint32_t)) {
    std::uint32_t word;
    std::memcpy(&word, bytes + k, sizeof word);
    sum = (sum ^ word) * kPrime;
  }
  return sum;
}

std::uint64_t checksum_of(const SurfelArrays& surfels, const std::vector<double>& numbers) {
  std::uint64_t sum = kChecksumStart;
  SurfelArrays::for_each_array(surfels, [&](const auto& array) { sum = checksum_of(array, sum); });
  return checksum_of(numbers, sum);
}

constexpr std::size_t kPose = 7;  // numbers

// All but the surfels.
std::vector<double> flat(const KeptMap& map) {
  std::vector<double> numbers;
  for (const SE3& pose : map.viewpoints) {
    const Eigen::Vector3d& t = pose.translation;
    const Eigen::Quaterniond& q = pose.rotation;
    numbers.insert(numbers.end(), {t.x(), t.y(), t.z(), q.w(), q.x(), q.y(), q.z()});
  }
  numbers.push_back(map.depth_scale);
  return numbers;
}

SE3 pose_of(const double* numbers) {
  return {Eigen::Quaterniond(numbers[3], numbers[4], numbers[5], numbers[6]),
          {numbers[0], numbers[1], numbers[2]}};
}

bool is_sound(const SE3& pose) {
  constexpr double kUnit = 1e-6;
  return pose.translation.allFinite() && std::abs(pose.rotation.norm() - 1) < kUnit;
}

std::uint64_t bytes_per_entry() {
  SurfelArrays one;
  one.resize(1);
  std::uint64_t bytes = 0;
  SurfelArrays::for_each_array(one, [&](const auto& array) { bytes += sizeof array[0]; });
  return bytes;
}

[[noreturn]] void refuse(const std::string& path, const std::string& why) {
  throw std::runtime_error(path + ": " + why +
                           "; give a map that visual_slam saved, or none to start a new one");
}

bool is_sound(const SurfelArrays& s, std::size_t k) {
  // Windows are added to times and taken from them.
  constexpr std::int64_t kLatest = std::numeric_limits<std::int64_t>::max() / 2;
  const auto is_time = [](std::int64_t utime) { return utime > -kLatest && utime < kLatest; };
  bool finite = true;
  SurfelArrays::for_each_array(s, [&](const auto& array) {
    finite = finite && std::isfinite(static_cast<double>(array[k]));
  });
  const bool empty = s.radius[k] == 0;
  return finite && s.radius[k] >= 0 && (empty || s.confidence[k] >= 0) &&
         is_time(s.initialised[k]) && is_time(s.updated[k]);
}

}  // namespace

void save_map(const std::string& path, const KeptMap& map) {
  const SurfelArrays& surfels = map.surfels;
  const std::vector<double> numbers = flat(map);
  Header header;
  header.viewpoints = static_cast<std::uint32_t>(map.viewpoints.size());
  header.count = surfels.size();
  header.checksum = checksum_of(surfels, numbers);
  write_whole(path, [&](std::ofstream& file) {
    file.write(reinterpret_cast<const char*>(&header), sizeof header);
    SurfelArrays::for_each_array(surfels, [&](const auto& array) {
      file.write(reinterpret_cast<const char*>(array.data()),
                 static_cast<std::streamsize>(array.size() * sizeof array[0]));
    });
    file.write(reinterpret_cast<const char*>(numbers.data()),
               static_cast<std::streamsize>(numbers.size() * sizeof(double)));
  });
}

KeptMap load_map(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::error_code error;
  const std::uintmax_t size = std::filesystem::file_size(path, error);
  if (!file || error) refuse(path, "cannot be read");
  Header header;
  header.magic = {};
  if (!file.read(reinterpret_cast<char*>(&header), sizeof header) || header.magic != kMagic) {
    refuse(path, "is not a map of surfels");
  }
  if (header.version != kVersion) {
    refuse(path, "is a map of version " + std::to_string(header.version) + ", this program reads " +
                     std::to_string(kVersion));
  }
  // Ids are int32, so the product below cannot overflow.
  if (header.count > static_cast<std::uint64_t>(std::numeric_limits<std::int32_t>::max()) ||
      size != sizeof header + header.count * bytes_per_entry() +
                  (header.viewpoints * kPose + 1) * sizeof(double)) {
    refuse(path, "is cut off or damaged: it is " + std::to_string(size) + " bytes long, and of " +
                     std::to_string(header.count) + " surfels by its own account");
  }
  KeptMap map;
  SurfelArrays& surfels = map.surfels;
  surfels.resize(header.count);
  SurfelArrays::for_each_array(surfels, [&](auto& array) {
    file.read(reinterpret_cast<char*>(array.data()),
              static_cast<std::streamsize>(array.size() * sizeof array[0]));
  });
  std::vector<double> numbers(header.viewpoints * kPose + 1);
  file.read(reinterpret_cast<char*>(numbers.data()),
            static_cast<std::streamsize>(numbers.size() * sizeof(double)));
  if (!file || checksum_of(surfels, numbers) != header.checksum) {
    refuse(path, "is damaged: its checksum is wrong");
  }
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    if (!is_sound(surfels, k)) refuse(path, "is damaged: surfel " + std::to_string(k) + " is none");
  }
  for (std::size_t k = 0; k + 1 < numbers.size(); k += kPose) {
    map.viewpoints.push_back(pose_of(numbers.data() + k));
    if (!is_sound(map.viewpoints.back())) refuse(path, "is damaged: a viewpoint is no pose");
  }
  map.depth_scale = numbers.back();
  if (!std::isfinite(map.depth_scale) || map.depth_scale < 0) {
    refuse(path, "is damaged: its depth_scale is none");
  }
  return map;
}

}  // namespace gastronaut::slam
