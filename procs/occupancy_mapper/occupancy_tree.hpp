// The octree that octomap's programs open, kept up to date block by block: what a change costs does
// not grow with the tree. Free space is in it as coarse as it can be, wall at the finest level.
#pragma once

#include <octomap/OcTree.h>

#include <string>
#include <vector>

#include "occupancy_mapper/space_blocks.hpp"

namespace gastronaut::occupancy {

// Told in the file's header as comments, which readers skip.
struct TreeComment {
  std::string key;
  std::string value;
};

class OccupancyTree : public octomap::OcTree {
 public:
  explicit OccupancyTree(double leaf_size) : octomap::OcTree(leaf_size) {}  // metres

  // `lowest`: the voxel at the block's lowest corner. Voxels that are neither occupied nor free are
  // not in the tree. Nodes above are brought up to date.
  void set_block(const VoxelIndex& lowest, const BlockState& state);

  // The whole file: .bt tells occupied, free and unknown, .ot how sure of it as well. The same tree
  // gives the same bytes.
  std::string as_bt(const std::vector<TreeComment>& comments) const;
  std::string as_ot(const std::vector<TreeComment>& comments) const;

 private:
  std::string header(const std::string& first_line, const std::vector<TreeComment>& comments) const;
  bool set_below(octomap::OcTreeNode* node, bool is_new, unsigned depth,
                 const octomap::OcTreeKey& key, const BlockState& state);
  void make_leaf(octomap::OcTreeNode* node);
  void fill(octomap::OcTreeNode* node, int side, const VoxelIndex& lowest, const BlockState& state);
};

}  // namespace gastronaut::occupancy
