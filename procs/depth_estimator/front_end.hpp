// From what the camera sends to linear light on an undistorted pinhole grid, with a word on how
// good the picture is.
#pragma once

#include <array>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <string>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "depth_estimator/highlights.hpp"
#include "depth_estimator/picture_decoder.hpp"
#include "image/plane.hpp"

namespace gastronaut::perception {

enum PixelFlag : std::uint8_t {
  kOutside = 1,    // the lens does not see it
  kHighlight = 2,  // a lamp's mirror reflection
  kRedSaturated = 4,
  kGreenSaturated = 8,
  kBlueSaturated = 16,
};

struct PictureQuality {
  // Root mean square of the picture's differences over 2 pixels, over that of its differences over
  // 8, in the direction where this is smaller: 1 for fine grain, 0.25 where nothing is finer than 8
  // pixels. Falls with defocus and motion blur; brightness and contrast cancel.
  double sharpness = 0;
  // Root mean square of its differences over 8 pixels, over its mean level: what there is to see.
  // Fluid before the lens and a wall far out of focus leave little.
  double contrast = 0;
  double mean_level = 0;          // green, 0 to 1, gamma-encoded
  double saturated_fraction = 0;  // of the pixels inside the lens: in one channel at least
  double dark_fraction = 0;       // in all channels
  double highlight_fraction = 0;
};

// The pinhole camera has the configuration's width, height, fx, fy, cx, cy.
struct LinearPicture {
  std::array<Plane<float>, 3> light;  // red, green, blue: linear, full scale being 1
  // 0 to 1, gamma-encoded, shows vessels. Highlights and what is dark or outside are filled from
  // around, or their rims would look like vessels.
  Plane<float> green_level;
  Plane<std::uint8_t> flags;  // bits of PixelFlag
  PictureQuality quality;
};

class FrontEnd {
 public:
  explicit FrontEnd(const CameraConfiguration& camera);

  // After a failure of kind "corrupt" or "size" `picture` is as it was, else it is filled.
  PictureFailure process(const EncodedPicture& encoded, LinearPicture& picture);

 private:
  void make_maps(const CameraConfiguration& camera);
  void undistort();
  void develop(LinearPicture& picture);
  PictureFailure judge(LinearPicture& picture) const;

  int width_;
  int height_;
  PictureDecoder decoder_;
  std::array<float, 256> light_of_level_;
  bool distorted_ = false;
  cv::Mat map_, map_fraction_;  // fixed-point maps of cv::remap
  Plane<std::uint8_t> outside_;
  std::vector<std::uint8_t> decoded_;      // RGB, as the lens sees it
  std::vector<std::uint8_t> undistorted_;  // RGB
  Plane<std::uint8_t> highlights_;
  Plane<std::uint8_t> empty_;  // to be filled: highlights, dark, outside
  HighlightFiller filler_;
};

}  // namespace gastronaut::perception
