// One channel of a picture: rows of equal length, one after the other, without padding.
#pragma once

#include <cstddef>
#include <vector>

namespace gastronaut {

template <class Value>
struct Plane {
  int width = 0;  // pixels
  int height = 0;
  std::vector<Value> values;  // width * height, row by row

  Plane() = default;
  Plane(int width_, int height_, Value value = {})
      : width(width_),
        height(height_),
        values(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_), value) {}

  std::size_t size() const { return values.size(); }
  bool same_size(int w, int h) const { return width == w && height == h; }
  Value* row(int v) { return values.data() + offset(v); }
  const Value* row(int v) const { return values.data() + offset(v); }
  Value& at(int u, int v) { return row(v)[u]; }
  const Value& at(int u, int v) const { return row(v)[u]; }

 private:
  std::ptrdiff_t offset(int v) const { return static_cast<std::ptrdiff_t>(v) * width; }
};

}  // namespace gastronaut
