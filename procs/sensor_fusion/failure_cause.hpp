// Why a sensor cannot be used, in the words of sensor_health_t.
#pragma once

#include <string>

namespace gastronaut::fusion {

// What ALBEDO's metadata tell of a picture.
struct PictureQuality {
  std::string failure;            // depth_estimator's word for why it cannot be used; empty: it can
  double sharpness = 0;           // 0: not told
  double highlight_fraction = 0;  // 0..1 of the pixels
};

// Words for vision's failures; remembers how sharp pictures were lately.
class VisualCause {
 public:
  void add(const PictureQuality& picture);
  // Why a frame with the picture added last was lost or badly held: "blur", "specular", "dark",
  // "overexposed", "foreign light", "corrupt", "low texture" (tracked, but badly held) or "lost".
  std::string describe(bool is_lost) const;

 private:
  PictureQuality picture_;
  double usual_sharpness_ = 0;
};

// Of magnetic_pose_t's status; empty when it is OK.
std::string magnetic_cause(int status);

}  // namespace gastronaut::fusion
