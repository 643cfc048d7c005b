#include "visual_slam/map_keeper.hpp"

#include <chrono>
#include <exception>
#include <utility>

namespace gastronaut::slam {

bool MapKeeper::is_free() const {
  return !writing_.valid() ||
         writing_.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
}

bool MapKeeper::save(KeptMap snapshot) {
  if (!is_free()) return false;
  if (writing_.valid()) collect();
  writing_ =
      std::async(std::launch::async, [path = path_, kept = std::move(snapshot)]() -> std::string {
        try {
          save_map(path, kept);
        } catch (const std::exception& error) {
          return error.what();
        }
        return {};
      });
  return true;
}

void MapKeeper::wait() {
  if (writing_.valid()) collect();
}

const std::string& MapKeeper::problem() {
  if (writing_.valid() && is_free()) collect();
  return problem_;
}

void MapKeeper::collect() { problem_ = writing_.get(); }

}  // namespace gastronaut::slam
