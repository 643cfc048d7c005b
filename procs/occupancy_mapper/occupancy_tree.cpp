#include "occupancy_mapper/occupancy_tree.hpp"

#include <fmt/format.h>

#include <sstream>

namespace gastronaut::occupancy {
namespace {

constexpr unsigned kBlockDepth = 14;  // of 16 levels: four voxels a side

// Bits of the voxels of a cube within its block.
std::uint64_t cube_bits(const VoxelIndex& lowest, int side) {
  std::uint64_t bits = 0;
  for (int z = 0; z < side; ++z) {
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        bits |= std::uint64_t{1} << voxel_in_block(lowest + VoxelIndex(x, y, z));
      }
    }
  }
  return bits;
}

}  // namespace

void OccupancyTree::set_block(const VoxelIndex& lowest, const BlockState& state) {
  const octomap::OcTreeKey key(static_cast<octomap::key_type>(lowest.x()),
                               static_cast<octomap::key_type>(lowest.y()),
                               static_cast<octomap::key_type>(lowest.z()));
  const bool is_new = root == nullptr;
  if (is_new) {
    if (state.is_unknown()) return;
    root = new octomap::OcTreeNode();  // the tree's own way: it deletes it
    ++tree_size;
  }
  if (!set_below(root, is_new, 0, key, state)) clear();
  size_changed = true;
}

// False: nothing is known below the node any more, and it has no children.
bool OccupancyTree::set_below(octomap::OcTreeNode* node, bool is_new, unsigned depth,
                              const octomap::OcTreeKey& key, const BlockState& state) {
  if (depth == kBlockDepth) {
    if (nodeHasChildren(node)) make_leaf(node);
    if (state.is_unknown()) return false;
    fill(node, kBlockSide, VoxelIndex::Zero(), state);
    return true;
  }
  const unsigned child = octomap::computeChildIdx(key, static_cast<int>(tree_depth - 1 - depth));
  bool child_is_new = false;
  if (!nodeChildExists(node, child)) {
    if (!nodeHasChildren(node) && !is_new) {
      expandNode(node);
    } else {
      if (state.is_unknown()) return true;
      createNodeChild(node, child);
      child_is_new = true;
    }
  }
  if (!set_below(getNodeChild(node, child), child_is_new, depth + 1, key, state)) {
    deleteNodeChild(node, child);
    if (!nodeHasChildren(node)) {
      make_leaf(node);
      return false;
    }
  }
  if (!pruneNode(node)) node->updateOccupancyChildren();
  return true;
}

// Only pruning gives back the memory of a node's list of children, and it wants eight equal leaves.
void OccupancyTree::make_leaf(octomap::OcTreeNode* node) {
  for (unsigned i = 0; i < 8; ++i) {
    octomap::OcTreeNode* child =
        nodeChildExists(node, i) ? getNodeChild(node, i) : createNodeChild(node, i);
    if (nodeHasChildren(child)) make_leaf(child);
    child->setLogOdds(0);
  }
  pruneNode(node);
}

// A new node for the cube, which is in part known.
void OccupancyTree::fill(octomap::OcTreeNode* node, int side, const VoxelIndex& lowest,
                         const BlockState& state) {
  const std::uint64_t cube = cube_bits(lowest, side);
  if ((state.occupied & cube) == cube || (state.free & cube) == cube) {
    node->setLogOdds((state.free & cube) != 0 ? clamping_thres_min : clamping_thres_max);
    return;
  }
  const int half = side / 2;
  for (unsigned i = 0; i < 8; ++i) {
    const auto at = [i, half](unsigned axis) { return (i >> axis & 1) != 0 ? half : 0; };
    const VoxelIndex part = lowest + VoxelIndex(at(0), at(1), at(2));
    if (((state.occupied | state.free) & cube_bits(part, half)) == 0) continue;
    fill(createNodeChild(node, i), half, part, state);
  }
  node->updateOccupancyChildren();
}

std::string OccupancyTree::header(const std::string& first_line,
                                  const std::vector<TreeComment>& comments) const {
  std::string text = first_line + "\n";
  for (const TreeComment& comment : comments) {
    text += fmt::format("# {} {}\n", comment.key, comment.value);
  }
  return text + fmt::format("id {}\nsize {}\nres {}\ndata\n", getTreeType(), size(), resolution);
}

std::string OccupancyTree::as_bt(const std::vector<TreeComment>& comments) const {
  std::ostringstream stream(header(binaryFileHeader, comments), std::ios::ate);
  writeBinaryData(stream);
  return stream.str();
}

std::string OccupancyTree::as_ot(const std::vector<TreeComment>& comments) const {
  std::ostringstream stream(header(fileHeader, comments), std::ios::ate);
  writeData(stream);
  return stream.str();
}

}  // namespace gastronaut::occupancy
