// Where the camera may be after tracking was lost: keyframes stored as tiny pictures of what the
// camera saw, compared with the frame at hand over in-plane rotations and shifts.
//
// Albedo (the lamp is divided out) less its local mean, and the logarithm of depth less its mean,
// are compared by normalised correlation at about 20 x 15 pixels. The best alignments pair pixels
// of the frame with pixels of the keyframe; as both have depth, the pairs' points give the motion
// between the two in closed form (Kabsch 1976; Umeyama 1991), so that the pose proposed is
// already corrected for where the camera stands and looks now.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "geometry/se3.hpp"
#include "visual_slam/deformation_graph.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/similarity.hpp"

namespace gastronaut::slam {

struct RelocaliserOptions {
  double distance = 0.1;      // of a frame's middle depth: nearer to a keyframe is nothing new
  double angle = 0.15;        // radians, likewise; a frame is stored if either is exceeded
  int most = 500;             // keyframes kept; beyond it a new one replaces the nearest
  double depth_weight = 0.5;  // of the correlation of depths beside that of albedos
  double least_score = 0.3;   // correlation, -1 to 1: below it a keyframe is not proposed
};

class Relocaliser {
 public:
  // Frames must have this grid; throws std::invalid_argument for one too small or bad options.
  Relocaliser(const PinholeGrid& grid, const RelocaliserOptions& options);

  // Remembers what the camera saw from there if no stored pose is as near; whether it did. A frame
  // with little depth or albedo is not stored.
  bool add(const Frame& frame, const SE3& map_T_camera);

  // Poses (map_T_camera) from which the map is worth a try, best first, at most `most`; of those
  // remembered from frames before that utime.
  std::vector<SE3> candidates(const Frame& frame, int most,
                              std::int64_t seen_before = INT64_MAX) const;

  // All that another one of the same grid and options remembers, as far as there is room.
  void add(const Relocaliser& other);
  // What is stored goes to another frame and other metres.
  void transform(const Similarity& similarity);
  // The cameras go with what they saw.
  void deform(const DeformationGraph& graph);

  std::vector<SE3> viewpoints() const;
  int size() const { return static_cast<int>(keyframes_.size()); }

 private:
  struct Keyframe {
    std::int64_t utime = 0;
    SE3 map_T_camera;
    double distance = 0;             // metres, middle depth
    std::vector<std::int16_t> code;  // of albedo, then of depth, each of unit length, scaled
    std::vector<float> depth;        // metres, tiny picture; 0: none
  };
  // The frame turned about its middle and then shifted, in pixels, lies on the keyframe.
  struct Alignment {
    int half_turns = 0;  // halves of the coarse search's step
    int du = 0;
    int dv = 0;
  };
  struct Match {
    float score = 0;
    int keyframe = -1;
    Alignment alignment;
  };
  struct Tiny {
    std::vector<float> albedo;     // negative: none
    std::vector<float> contrast;   // albedo less its local mean; 0: none
    std::vector<float> depth;      // metres; 0: none
    std::vector<float> log_depth;  // where there is any
    double distance = 0;           // metres, middle depth; 0: too little to go by
  };

  Tiny shrink(const Frame& frame) const;
  std::vector<std::int16_t> turned_pixels(int half_turns) const;
  // By column: the frame's pixel that lies there; -1: none.
  const std::int16_t* sources_of_row(int v, const Alignment& alignment) const;
  std::vector<std::int16_t> code(const Tiny& tiny, const Alignment& alignment) const;
  bool correct(const Tiny& tiny, const Match& match, SE3& map_T_camera) const;

  PinholeGrid grid_;
  RelocaliserOptions options_;
  int factor_;
  PinholeGrid tiny_;
  int margin_;                                     // pixels that a picture may be shifted
  std::vector<std::vector<std::int16_t>> turned_;  // by half turns
  std::vector<Keyframe> keyframes_;
};

}  // namespace gastronaut::slam
