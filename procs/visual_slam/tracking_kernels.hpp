// The tracker's loops over pixels, compiled for each instruction set and chosen when the program
// runs. The same operations in the same order on all of them.
#pragma once

#include <array>
#include <vector>

#include "visual_slam/tracking_pyramid.hpp"

namespace gastronaut::slam {

// level.albedo of rows [begin, end) from level.raw_albedo: (a - mean) / (deviation + floor * mean)
// over a square window, masked pixels left out; NaN where the picture's border cuts the window.
void normalise_contrast(FrameLevel& level, float floor, int begin, int end);

// Where the camera is for the pixels to be compared, and what counts.
struct TrackingState {
  std::array<float, 9> frame_R_model;  // row by row
  std::array<float, 3> centre;         // of the frame's camera, model view's frame, metres
  float depth_scale = 1;               // the frame's depth is multiplied by it
  float icp_sigma = 1;                 // of relative depth; scales the robust weights
  float rgb_sigma = 1;                 // of normalised albedo
  float distance_gate = 0;             // relative depth
  float rgb_gate = 0;                  // normalised albedo
  float cosine_gate2 = 0;              // square of the least cosine of the viewing angle
  float jump = 0;                      // see PyramidOptions
};

inline constexpr int kIcpUnknowns = 7;  // twist of the model's points, log of the depth scale
inline constexpr int kRgbUnknowns = 6;  // twist
constexpr int triangle(int n) { return n * (n + 1) / 2; }

// Sums over pixels with Cauchy's weights w; matrices are upper triangles, row by row.
enum TrackingSum : int {
  kIcpMatrix = 0,                                    // w J^T J
  kIcpVector = kIcpMatrix + triangle(kIcpUnknowns),  // w J^T q
  kRgbMatrix = kIcpVector + kIcpUnknowns,
  kRgbVector = kRgbMatrix + triangle(kRgbUnknowns),
  kIcpWeight = kRgbVector + kRgbUnknowns,  // w
  kIcpSquare,                              // w q^2
  kIcpMetres2,                             // w (distance to the plane)^2
  kIcpInliers,                             // pixels within the scale of Cauchy's weight
  kIcpCompared,                            // pixels where the frame has depth
  kRgbWeight,
  kRgbSquare,
  kRgbInliers,
  kRgbCompared,   // pixels where both have albedo
  kFrameAlbedo2,  // sums of squares and product of both albedos, for their correlation
  kModelAlbedo2,
  kAlbedoProduct,
  kVisible,   // pixels of the model view with depth
  kDepthSum,  // metres
  kTrackingSums
};
using TrackingSums = std::array<double, kTrackingSums>;

// Gradients w J^T r of a block of kTrackingLanes columns and of the rows asked for.
struct BlockGradient {
  std::array<double, kIcpUnknowns> icp{};
  std::array<double, kRgbUnknowns> rgb{};
};

// Beyond this many sigmas a residual's weight falls below one half (95 % efficient on Gaussians).
inline constexpr float kCauchyScale = 2.385F;

// Compares each pixel P of the model view's rows [begin, end), seen from the frame's camera along
// the ray d = P - centre, with the frame where P falls in it:
//   q = scale * depth_frame / depth_of_P - 1, which is the distance of the frame's point to P's
//       tangent plane over n . d, so dq / dP = -n / (n . d);
//   e = albedo_frame - albedo_model, whose derivative by P takes into account that P's neighbours
//       lie on its tangent plane: g - n (g . d) / (n . d), g the derivative in the model view.
// `blocks` is one row of blocks, or null.
TrackingSums compare(const ModelLevel& model, const FrameLevel& frame, const TrackingState& state,
                     int begin, int end, BlockGradient* blocks);

}  // namespace gastronaut::slam
