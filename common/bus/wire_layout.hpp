// The wire layout of an LCM type as a table; lcmtypes/generate_wire_schema.py writes one for each.
#pragma once

#include <array>
#include <cstdint>

namespace gastronaut {

enum class WireKind : std::uint8_t {
  kInt8,
  kUint8,
  kBoolean,
  kInt16,
  kInt32,
  kInt64,
  kFloat,
  kDouble,
  kString,
  kStruct,
};

struct WireLayout;

// Length of one array dimension: fixed, or the value of an earlier integer field.
struct WireDimension {
  std::int32_t fixed;
  int field;  // index of the field that holds the length, -1: fixed
};

struct WireField {
  const char* name;
  WireKind kind;
  const WireLayout* nested;  // for kStruct
  int num_dimensions;
  std::array<WireDimension, 2> dimensions;
};

struct WireLayout {
  const char* name;
  const WireField* fields;
  int num_fields;
};

template <class Message>
struct WireLayoutOf;

}  // namespace gastronaut
