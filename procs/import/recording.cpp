#include "import/recording.hpp"

#include <stdexcept>

#include "import/files.hpp"

namespace gastronaut {
std::vector<StampedPose> make_poses(const PoseTable& table, double seconds_per_frame, double epoch,
                                    const std::string& name, Issues& issues) {
  std::vector<std::int64_t> utimes;
  for (const PoseRow& pose : table.poses) {
    utimes.push_back(to_utime(table.by_frame ? pose.time * seconds_per_frame : pose.time, epoch));
  }
  std::vector<StampedPose> poses;
  for (const std::size_t i : forward_in_time(utimes, issues, [&](std::size_t index) {
         return place(name, table.poses[index].line);
       })) {
    poses.push_back({utimes[i], table.poses[i].world_T_camera});
  }
  return poses;
}

Series read_series(const std::string& path, std::size_t columns, double epoch, Issues& issues) {
  // In two statements: the text of an hour's readings is gigabytes, and not needed any more.
  const Table table = parse_table(read_text(path), columns + 1, path, issues);
  const Series series = make_series(table, epoch, path, issues);
  if (series.size() == 0) {
    throw std::runtime_error(path + ": has no usable row; expected the time in seconds and " +
                             std::to_string(columns) + " numbers in each");
  }
  return series;
}

std::vector<StampedPose> read_poses(const std::string& path, double seconds_per_frame, double epoch,
                                    Issues& issues) {
  const std::vector<StampedPose> poses = make_poses(parse_pose_table(read_text(path), path, issues),
                                                    seconds_per_frame, epoch, path, issues);
  if (poses.empty()) {
    throw std::runtime_error(path +
                             ": has no usable pose; expected rows of 'time tx ty tz qx qy "
                             "qz qw' (TUM), of 12 numbers (KITTI), or Open3D's .log");
  }
  return poses;
}

}  // namespace gastronaut
