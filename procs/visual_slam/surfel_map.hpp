// The map: surfels that depth pictures are fused into, after the paper's section on map fusion
// and ElasticFusion (Whelan et al., RSS 2015), with every length scaled to the distance.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "visual_slam/deformation_graph.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/similarity.hpp"
#include "visual_slam/surfel_arrays.hpp"
#include "visual_slam/surfel_blocks.hpp"
#include "visual_slam/surfel_normals.hpp"

namespace gastronaut::slam {

// Fractions are of the depth at hand; the one length says what world it is.
struct SurfelMapOptions {
  double working_distance = 0.05;  // metres, typical: a capsule's; 2 for a room
  double block_size = 0.2;         // of the working distance
  double farthest = 4;             // working distances; depth beyond is not used, nor drawn

  double depth_gate = 0.03;      // fraction: measured and predicted are one surface
  double depth_gate_sigmas = 3;  // the same in the frame's sigmas; the wider of both counts
  double angle_gate = 0.5;       // radians between measured and predicted normal
  double minimum_cosine = 0.15;  // between normal and line of sight; flatter is not used
  double radius_growth = 1.5;  // above this times the old radius the view is too coarse to move it
  double trusted_relative_std = 0.05;  // frames n times as uncertain weigh 1 / n^2

  // Surfels of one surface become one when their centres are this near, in radii of the surfel:
  // those that one frame makes are 0.7 apart, 0.35 on the flattest wall.
  double merge_distance = 0.35;  // along the surface, where rays meet it
  double merge_thickness = 3;    // across it

  double stable_confidence = 10;
  double confidence_limit = 200;  // so that what changes is still followed
  double active_window = 6.7;     // seconds since the last update: 200 frames
  double unseen_limit = 3;        // seconds that an unstable surfel stays unseen
  double least_confidence = 0.5;  // halved by each frame that sees through it; below: removed

  int reserved_surfels = 2'000'000;  // address space set aside, so that growing is no stutter
};

// kActive: what was updated lately. kOld: what was first seen before that.
enum class MapPart { kActive, kOld, kAll };

struct FuseReport {
  int associated = 0;  // surfels that a measurement went into
  int created = 0;
  int seen_through = 0;  // surfels in the free space of the frame
  int removed_unstable = 0;
  int removed_free_space = 0;
  int merged = 0;  // into others
};

struct MapIncrement {
  std::vector<std::int32_t> changed;  // ids new or changed since the last increment, ascending
  std::vector<std::int32_t> removed;  // ids no longer in the map, ascending; some may be unheard of
};

// Ids are stable: a surfel keeps its id until it is removed, and the id is not given to another
// before the removal was handed out by take_increment (so call that regularly). All results are
// the same bytes whatever the number of threads. predict may run beside other reading calls and
// take_increment, but not beside what changes surfels.
class SurfelMap {
 public:
  // Throws std::invalid_argument for options that make no sense.
  explicit SurfelMap(const SurfelMapOptions& options);
  // Of surfels kept before (surfel_file.hpp). Throws as well if one lies out of reach.
  SurfelMap(const SurfelMapOptions& options, SurfelArrays surfels);

  // The map, or a part of it, from a pose at utime `now`. Costs what is in view, not what is in the
  // map.
  void predict(const SE3& map_T_camera, const PinholeGrid& grid, std::int64_t now, MapPart part,
               ModelView& view) const;

  // Fuses a frame taken at prediction.map_T_camera; predict from there first, same grid (else
  // std::invalid_argument), with nothing fused in between. A pixel and the surfel seen at it are
  // one surface if depths and normals agree: the surfel becomes the mean weighted by confidence,
  // each surfel once a frame, by the pixel nearest to it. A pixel before or beside all that is
  // predicted makes a surfel. A surfel clearly before what its pixel and all neighbours measure
  // is in free space. A surfel on top of one that was measured becomes one with it: else each frame
  // that errs to the front would leave a layer behind, and the map grow for ever.
  FuseReport fuse(const Frame& frame, const ModelView& prediction);

  // Another frame, and other metres: all surfels go there, and count as changed.
  void transform(const Similarity& similarity);

  // All surfels follow the graph; those that leave the map's reach are removed. Costs what is near
  // the nodes that move.
  void deform(const DeformationGraph& graph);

  // Surfels of another map in the same frame; they get ids of this one.
  void add(const SurfelArrays& others);

  // The frame is right and what the map shows at that pose may not be: surfels in front of what the
  // frame measures go, and those not far behind it, which are the same wall before it moved; the
  // others in view keep no more confidence than stable ones need.
  void give_way(const Frame& frame, const SE3& map_T_camera);

  // What to publish as MAP_SURFELS; the next increment starts here.
  MapIncrement take_increment();

  // The utime before which a surfel was made that is of the old part at `now`.
  std::int64_t old_before(std::int64_t now) const { return now - active_window_; }
  int size() const { return size_; }  // surfels in the map
  // By id, with gaps. A copy is a snapshot that can be saved while the map goes on.
  const SurfelArrays& surfels() const { return surfels_; }
  bool is_active(std::int32_t id, std::int64_t now) const;
  bool is_stable(std::int32_t id) const;

 private:
  enum class Verdict : std::uint8_t { kNothing, kNew, kAssociated, kSeenThrough };
  struct Pixel {
    Verdict verdict = Verdict::kNothing;
    std::int32_t surfel = -1;
    float distance2 = 0;  // square metres, from the measured point to the surfel's centre
  };
  struct Measurement;

  void judge_row(const Frame& frame, const ModelView& prediction, int v);
  Pixel judge(const Frame& frame, const ModelView& prediction, int u, int v) const;
  bool neighbours_see_through(const Frame& frame, int u, int v, float predicted) const;
  Measurement measure(const Frame& frame, const SE3& map_T_camera, std::size_t pixel) const;
  void update(std::int32_t id, const Measurement& measured, std::int64_t utime);
  // The arrays have room for it; nothing when there are no more.
  std::optional<std::size_t> new_id();
  bool create(const Measurement& measured, std::int64_t utime);
  bool see_through(std::int32_t id);
  int remove_unseen(std::int64_t now);
  void remove(std::int32_t id);
  void mark_changed(std::int32_t id);
  float depth_gate(const Frame& frame) const;
  void find_crowded(const ModelView& prediction);
  int merge_crowded();

  SurfelMapOptions options_;
  std::int64_t active_window_;  // microseconds
  std::int64_t unseen_limit_;
  float cosine_gate_;
  SurfelArrays surfels_;
  SurfelBlocks blocks_;
  int size_ = 0;
  std::vector<std::int32_t> free_ids_;
  // When to look at an unstable surfel again, as long as it is unstable.
  std::map<std::int64_t, std::vector<std::int32_t>> due_;

  std::vector<std::uint8_t> is_changed_;  // by id: listed in changed_
  std::vector<std::int32_t> changed_;
  std::vector<std::int32_t> removed_;

  // Of the frame being fused, kept for their memory.
  NormalMap normals_;
  std::vector<Pixel> pixels_;
  std::vector<std::int32_t> claim_of_;      // by id: index into claims_, -1 between frames
  std::vector<std::int32_t> claims_;        // pixels, each for a surfel of its own
  std::vector<std::int32_t> seen_through_;  // ids
  struct Crowded {
    std::int32_t surfel, into;
  };
  std::vector<std::vector<Crowded>> crowded_;  // by block in view
};

}  // namespace gastronaut::slam
