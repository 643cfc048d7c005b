#include "bus/wire.hpp"

#include <algorithm>
#include <array>
#include <limits>

namespace gastronaut {
namespace {

constexpr std::size_t kFingerprint = 8;
// The deepest of our types is two levels; a cycle cannot be written in an .lcm file.
constexpr int kMostFields = 64;

std::size_t size_of(WireKind kind) {
  switch (kind) {
    case WireKind::kInt8:
    case WireKind::kUint8:
    case WireKind::kBoolean:
      return 1;
    case WireKind::kInt16:
      return 2;
    case WireKind::kInt32:
    case WireKind::kFloat:
      return 4;
    case WireKind::kInt64:
    case WireKind::kDouble:
      return 8;
    case WireKind::kString:
    case WireKind::kStruct:
      return 0;
  }
  return 0;
}

// Walks over a message without decoding it.
class Measure {
 public:
  explicit Measure(Bytes rest) : rest_(rest) {}

  bool walk(const WireLayout& layout) {
    std::array<std::int64_t, kMostFields> counts{};
    if (layout.num_fields > kMostFields) return false;
    for (int i = 0; i < layout.num_fields; ++i) {
      const WireField& field = layout.fields[i];
      std::uint64_t elements = 1;
      for (int d = 0; d < field.num_dimensions; ++d) {
        const WireDimension& dimension = field.dimensions[static_cast<std::size_t>(d)];
        const std::int64_t length = dimension.field < 0
                                        ? dimension.fixed
                                        : counts[static_cast<std::size_t>(dimension.field)];
        // Rows of no columns take no bytes but one allocation each.
        if (length < 0 || static_cast<std::uint64_t>(length) > rest_.size()) return false;
        elements *= static_cast<std::uint64_t>(length);
        if (elements > rest_.size()) return false;
      }
      if (field.num_dimensions == 0 && is_count(field.kind)) {
        if (!peek(field.kind, counts[static_cast<std::size_t>(i)])) return false;
      }
      if (!skip(field, elements)) return false;
    }
    return true;
  }

  bool done() const { return rest_.empty(); }

 private:
  static bool is_count(WireKind kind) {
    return kind == WireKind::kInt8 || kind == WireKind::kInt16 || kind == WireKind::kInt32 ||
           kind == WireKind::kInt64;
  }

  bool peek(WireKind kind, std::int64_t& value) const {
    const std::size_t size = size_of(kind);
    if (rest_.size() < size) return false;
    std::uint64_t bits = (rest_[0] & 0x80) != 0 ? std::numeric_limits<std::uint64_t>::max() : 0;
    for (std::size_t i = 0; i < size; ++i) bits = (bits << 8) | rest_[i];
    value = static_cast<std::int64_t>(bits);
    return true;
  }

  bool advance(std::uint64_t bytes) {
    if (bytes > rest_.size()) return false;
    rest_ = rest_.subspan(bytes);
    return true;
  }

  bool skip(const WireField& field, std::uint64_t elements) {
    if (field.kind == WireKind::kStruct) {
      for (std::uint64_t e = 0; e < elements; ++e) {
        if (!walk(*field.nested)) return false;
      }
      return true;
    }
    if (field.kind == WireKind::kString) {
      for (std::uint64_t e = 0; e < elements; ++e) {
        std::int64_t length = 0;
        if (!peek(WireKind::kInt32, length) || !advance(size_of(WireKind::kInt32))) return false;
        // A string's length counts its closing zero, and there is no other zero: LCM's encoders
        // stop at the first one, so that such a string could not be written again.
        if (length < 1 || static_cast<std::uint64_t>(length) > rest_.size()) return false;
        const Bytes text = rest_.first(static_cast<std::size_t>(length));
        if (std::find(text.begin(), text.end(), std::uint8_t{0}) != text.end() - 1) return false;
        if (!advance(static_cast<std::uint64_t>(length))) return false;
      }
      return true;
    }
    return advance(elements * size_of(field.kind));
  }

  Bytes rest_;
};

template <class... Messages>
const WireLayout* find_layout(std::uint64_t fingerprint) {
  const WireLayout* found = nullptr;
  ((static_cast<std::uint64_t>(Messages::getHash()) == fingerprint
        ? void(found = &WireLayoutOf<Messages>::value)
        : void()),
   ...);
  return found;
}

}  // namespace

bool wire_length_matches(const WireLayout& layout, Bytes payload) {
  if (payload.size() < kFingerprint ||
      payload.size() > static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max())) {
    return false;
  }
  Measure measure(payload.subspan(kFingerprint));
  return measure.walk(layout) && measure.done();
}

const WireLayout* layout_of_fingerprint(std::uint64_t fingerprint) {
  return find_layout<capsule_state_t, coil_currents_t, depth_image_t, hall_array_t, image_t,
                     magnetic_pose_t, map_deformation_t, map_surfels_t, occupancy_t, pose_t,
                     process_status_t, rig_config_t, rigid_transform_t, visual_pose_t>(fingerprint);
}

}  // namespace gastronaut
