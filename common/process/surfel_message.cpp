#include "process/surfel_message.hpp"

namespace gastronaut {

std::size_t apply_message(const map_surfels_t& message, SurfelStore& surfels) {
  if (message.reset) surfels.reset();
  for (const std::int32_t id : message.removed) surfels.remove(id);
  std::size_t refused = 0;
  for (std::size_t i = 0; i < message.id.size(); ++i) {
    const Surfel surfel{{message.x[i], message.y[i], message.z[i]},
                        {message.nx[i], message.ny[i], message.nz[i]},
                        {message.red[i], message.green[i], message.blue[i]},
                        message.radius[i],
                        message.confidence[i],
                        message.utime};
    if (!surfels.set(message.id[i], surfel)) ++refused;
  }
  return refused;
}

}  // namespace gastronaut
