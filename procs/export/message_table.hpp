// Messages of one LCM type as rows of a CSV file, by the type's wire layout: whatever the type.
//
// Every member is a column; arrays are one column an element, as in position_0, covariance_2_5 and
// sensors_1_name, as many as the longest message has, cells of shorter ones staying empty. Arrays
// of more than 512 elements (surfels, deformation nodes) are left out: the member that holds their
// length says how many there were. Byte arrays are one column: text where all of it is printable
// ASCII, else hexadecimal (0x...); those of more than 64 bytes (pictures) are left out as well.
// Numbers are written so that reading them gives the same bits; texts with commas, quotes or
// line ends are quoted as in RFC 4180.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>

#include "bus/wire.hpp"

namespace gastronaut {

class MessageTable {
 public:
  explicit MessageTable(const WireLayout& layout) : layout_(layout) {}

  const WireLayout& layout() const { return layout_; }
  // Payloads must have passed wire_length_matches(). First all of them to measure(); then header()
  // and row() fit together.
  void measure(Bytes payload);
  std::string header() const;
  std::string row(Bytes payload) const;

 private:
  using Lengths = std::array<std::int64_t, 2>;
  class Walk;

  const WireLayout& layout_;
  std::map<std::string, Lengths> longest_;  // by the array's path: a.b
};

}  // namespace gastronaut
