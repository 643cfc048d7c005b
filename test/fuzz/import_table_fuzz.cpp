// Any text as a table of readings (the first byte says how many columns) and as a trajectory.
#include <cmath>
#include <string>

#include "fuzz_check.hpp"
#include "import/pose_table.hpp"
#include "import/table.hpp"
#include "import/timeline.hpp"

using namespace gastronaut;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  constexpr std::size_t kMostColumns = 16;
  const std::size_t columns = 1 + data[0] % kMostColumns;
  const std::string_view text(reinterpret_cast<const char*>(data + 1), size - 1);
  Issues issues([](const std::string& what, std::size_t) {
    promise(what.starts_with("file:"), "an issue names its file and line");
  });

  const Table table = parse_table(text, columns, "file", issues);
  promise(table.values.size() == table.rows() * columns, "a row has all its columns");
  for (const double value : table.values) promise(std::isfinite(value), "values are finite");
  constexpr double kEpoch = 1.7e9;
  const std::size_t bad_rows = issues.count();
  const Series series = make_series(table, kEpoch, "file", issues);
  promise(series.size() + issues.count() - bad_rows == table.rows(), "no row gets lost");
  for (std::size_t i = 0; i + 1 < series.size(); ++i) {
    promise(series.utimes[i] < series.utimes[i + 1], "time goes forward");
    promise(series.seqs[i] < series.seqs[i + 1], "seq goes forward");
  }

  for (const PoseRow& pose : parse_pose_table(text, "file", issues).poses) {
    constexpr double kRounding = 1e-9;
    promise(std::abs(pose.world_T_camera.rotation.norm() - 1) < kRounding, "rotations are unit");
    promise(pose.world_T_camera.translation.allFinite(), "translations are finite");
  }
  return 0;
}
