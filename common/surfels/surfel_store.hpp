// The surfels that MAP_SURFELS told of, as they are after the last message.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

namespace gastronaut {

struct Surfel {
  Eigen::Vector3f position = Eigen::Vector3f::Zero();  // metres, map frame
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();    // unit, towards the side it was seen from
  std::array<std::uint8_t, 3> colour{};                // red, green, blue
  float radius = 0;                                    // metres
  float confidence = 0;
  // Microseconds: of the message that last said more of it than that it has moved.
  std::int64_t measured_utime = 0;
};

inline bool is_stable(const Surfel& surfel, double least_confidence) {
  return static_cast<double>(surfel.confidence) >= least_confidence;
}

class SurfelStore {
 public:
  // New or changed; `surfel` comes with the message's utime. A bend of the map moves surfels and a
  // new frame tells all of them again: measured is what is new, has gained confidence, or has
  // another colour or radius; the others keep their measured_utime, over a reset too. False, and
  // nothing is kept, for what is no surfel: an id below zero, numbers that are not finite or beyond
  // reason, a radius that is not positive, no normal. Memory goes by the surfels kept, whatever
  // their ids.
  bool set(std::int32_t id, Surfel surfel);
  // An id that is not in the map is none of our business: it may have come and gone unheard of.
  void remove(std::int32_t id);
  void reset();

  std::size_t size() const { return surfels_.size(); }
  // Those of at least that confidence.
  std::size_t stable(double least_confidence) const;
  // In the order of their ids.
  std::vector<Surfel> list() const;

 private:
  std::unordered_map<std::int32_t, Surfel> surfels_;
  std::unordered_map<std::int32_t, Surfel> before_reset_;
};

}  // namespace gastronaut
