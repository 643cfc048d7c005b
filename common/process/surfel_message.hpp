// MAP_SURFELS into a map of surfels.
#pragma once

#include <cstddef>
#include <gastronaut/map_surfels_t.hpp>

#include "surfels/surfel_store.hpp"

namespace gastronaut {

// Forgets, removes and sets what the message says; returns how many of its surfels were none and
// were left out.
std::size_t apply_message(const map_surfels_t& message, SurfelStore& surfels);

}  // namespace gastronaut
