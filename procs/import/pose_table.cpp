#include "import/pose_table.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <cmath>
#include <optional>
#include <span>

#include "import/table.hpp"

namespace gastronaut {
namespace {

// Files print rotations with as few as four digits.
constexpr double kPrintedRounding = 0.01;
constexpr std::size_t kTumColumns = 8;
constexpr std::size_t kKittiColumns = 12;
constexpr std::size_t kOpen3dNumbers = 3 + 16;

using RowMajor3x4 = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;

std::optional<SE3> from_tum(std::span<const double> row) {
  const Eigen::Quaterniond rotation(row[7], row[4], row[5], row[6]);
  if (!(std::abs(rotation.norm() - 1) < kPrintedRounding)) return std::nullopt;
  return SE3{rotation.normalized(), {row[1], row[2], row[3]}};
}

std::optional<SE3> from_matrix(std::span<const double> row) {
  const RowMajor3x4 matrix = Eigen::Map<const RowMajor3x4>(row.data());
  const Eigen::Matrix3d printed = matrix.leftCols<3>();
  const double error = (printed * printed.transpose() - Eigen::Matrix3d::Identity()).norm();
  if (!(error < kPrintedRounding) || !(printed.determinant() > 0)) return std::nullopt;
  // The nearest rotation to what was rounded when it was printed.
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(printed, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d rotation = svd.matrixU() * svd.matrixV().transpose();
  return SE3{Eigen::Quaterniond(rotation).normalized(), matrix.col(3)};
}

// Joins each block of five lines into one row of 19 numbers.
Table parse_open3d(std::string_view text, const std::string& name, Issues& issues) {
  constexpr std::size_t kHeaderCells = 3;
  constexpr std::size_t kMatrixCells = 4;
  Table table;
  table.columns = kOpen3dNumbers;
  std::vector<double> block;
  std::size_t block_line = 0;
  const auto close_block = [&] {
    if (block.size() == kOpen3dNumbers) {
      table.values.insert(table.values.end(), block.begin(), block.end());
      table.lines.push_back(block_line);
    } else if (block_line != 0) {
      issues.left_out(place(name, block_line) +
                      ": no three frame numbers and four rows of four numbers; pose skipped");
    }
    block.clear();
  };
  for_each_row(text, [&](std::size_t line, std::span<const std::string_view> cells) {
    if (cells.size() == kHeaderCells || block_line == 0 || block.size() >= kOpen3dNumbers) {
      close_block();
      block_line = line;
    }
    if (cells.size() != (block.empty() ? kHeaderCells : kMatrixCells)) return;
    for (const std::string_view cell : cells) {
      if (const auto number = parse_number(cell)) block.push_back(*number);
    }
  });
  close_block();
  return table;
}

std::size_t columns_of_first_row(std::string_view text) {
  std::size_t columns = 0;
  for_each_row(text, [&](std::size_t, std::span<const std::string_view> cells) {
    if (columns == 0) columns = cells.size();
  });
  return columns;
}

}  // namespace

PoseTable parse_pose_table(std::string_view text, const std::string& name, Issues& issues) {
  const std::size_t columns = columns_of_first_row(text);
  const bool open3d = columns == 3;
  const bool kitti = columns == kKittiColumns;
  const Table numbers = open3d
                            ? parse_open3d(text, name, issues)
                            : parse_table(text, kitti ? kKittiColumns : kTumColumns, name, issues);
  PoseTable table;
  table.by_frame = open3d || kitti;
  for (std::size_t i = 0; i < numbers.rows(); ++i) {
    const auto row = numbers.row(i);
    const auto pose = open3d  ? from_matrix(row.subspan(3, kKittiColumns))
                      : kitti ? from_matrix(row)
                              : from_tum(row);
    if (!pose) {
      issues.left_out(place(name, numbers.lines[i]) + ": the rotation is none" +
                      (table.by_frame ? "" : " (the quaternion's norm is not 1)") +
                      "; row skipped");
      continue;
    }
    // A bad row leaves its frame without a pose and moves no other.
    const double time = kitti ? static_cast<double>(numbers.lines[i] - 1) : row[0];
    table.poses.push_back({time, *pose, numbers.lines[i]});
  }
  return table;
}

}  // namespace gastronaut
