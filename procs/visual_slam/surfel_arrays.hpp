// The fields of all surfels of a map, one array a field: entry i belongs to the surfel with id i.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace gastronaut::slam {

// Map frame. An entry whose radius is 0 is no surfel: all its other fields are 0 too.
// Red, green and blue come beside albedo once frames have them, and a deformation graph's
// influence (node and weight, k of each) as further arrays; both belong in for_each_array.
struct SurfelArrays {
  std::vector<float> x, y, z;             // metres
  std::vector<float> nx, ny, nz;          // unit normal, out of the tissue
  std::vector<float> albedo;              // 0 to 1; negative: never seen
  std::vector<float> confidence;          // sum of the weights of what was fused, limited
  std::vector<float> radius;              // metres
  std::vector<std::int64_t> initialised;  // utime of the frame that made it
  std::vector<std::int64_t> updated;      // utime of the latest frame fused into it

  std::size_t size() const { return x.size(); }
  bool holds(std::size_t id) const { return id < radius.size() && radius[id] > 0; }

  // Ids of the surfels of at least that confidence, ascending.
  std::vector<std::size_t> at_least(double least_confidence) const {
    std::vector<std::size_t> ids;
    for (std::size_t id = 0; id < size(); ++id) {
      if (holds(id) && static_cast<double>(confidence[id]) >= least_confidence) ids.push_back(id);
    }
    return ids;
  }

  // visit(array) in the order above, which is that of the file as well.
  template <class Self, class Visit>
  static void for_each_array(Self& self, const Visit& visit) {
    for (auto* array : {&self.x, &self.y, &self.z, &self.nx, &self.ny, &self.nz, &self.albedo,
                        &self.confidence, &self.radius}) {
      visit(*array);
    }
    for (auto* array : {&self.initialised, &self.updated}) visit(*array);
  }
  static void copy(const SurfelArrays& from, std::size_t k, SurfelArrays& to, std::size_t at) {
    for (const auto array :
         {&SurfelArrays::x, &SurfelArrays::y, &SurfelArrays::z, &SurfelArrays::nx,
          &SurfelArrays::ny, &SurfelArrays::nz, &SurfelArrays::albedo, &SurfelArrays::confidence,
          &SurfelArrays::radius}) {
      (to.*array)[at] = (from.*array)[k];
    }
    to.initialised[at] = from.initialised[k];
    to.updated[at] = from.updated[k];
  }
  void resize(std::size_t size) {
    for_each_array(*this, [size](auto& array) { array.resize(size); });
  }
  void reserve(std::size_t size) {
    for_each_array(*this, [size](auto& array) { array.reserve(size); });
  }

  bool operator==(const SurfelArrays&) const = default;
};

}  // namespace gastronaut::slam
