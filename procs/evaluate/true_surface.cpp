#include "evaluate/true_surface.hpp"

#include <embree3/rtcore.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string_view>

#include "numerics/counter_random.hpp"

namespace gastronaut::evaluation {
namespace {

static_assert(std::endian::native == std::endian::little);

enum class Scalar { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };

const std::map<std::string, Scalar>& scalar_names() {
  static const std::map<std::string, Scalar> names = {
      {"char", Scalar::kInt8},      {"int8", Scalar::kInt8},     {"uchar", Scalar::kUint8},
      {"uint8", Scalar::kUint8},    {"short", Scalar::kInt16},   {"int16", Scalar::kInt16},
      {"ushort", Scalar::kUint16},  {"uint16", Scalar::kUint16}, {"int", Scalar::kInt32},
      {"int32", Scalar::kInt32},    {"uint", Scalar::kUint32},   {"uint32", Scalar::kUint32},
      {"float", Scalar::kFloat},    {"float32", Scalar::kFloat}, {"double", Scalar::kDouble},
      {"float64", Scalar::kDouble},
  };
  return names;
}

struct Property {
  std::string name;
  Scalar type = Scalar::kFloat;
  std::optional<Scalar> count;  // of a list
};

struct Element {
  std::string name;
  std::uint64_t count = 0;
  std::vector<Property> properties;
};

class PlyReader {
 public:
  explicit PlyReader(const std::string& path) : path_(path) {
    std::ifstream file(path, std::ios::binary);
    if (!file) fail("cannot be read");
    data_.assign(std::istreambuf_iterator<char>(file), {});
  }

  TriangleMesh read() {
    read_header();
    TriangleMesh mesh;
    for (const Element& element : elements_) {
      // The least that an entry takes is a byte, so a count cannot ask for more than there is.
      if (element.count > data_.size()) fail("is shorter than its header says");
      for (std::uint64_t i = 0; i < element.count; ++i) read_entry(element, mesh);
    }
    for (const auto& triangle : mesh.triangles) {
      for (const std::uint32_t corner : triangle) {
        if (corner >= mesh.vertices.size()) fail("a face names a vertex that is not there");
      }
    }
    if (mesh.triangles.empty()) fail("holds no triangles, and without them there is no surface");
    return mesh;
  }

 private:
  [[noreturn]] void fail(const std::string& problem) const {
    throw std::runtime_error(path_ + ": " + problem +
                             "; wanted is a PLY file (ASCII or binary_little_endian) with vertex "
                             "x y z in metres and face vertex_indices");
  }

  void read_header() {
    if (next_line() != "ply") fail("is not a PLY file");
    for (;;) {
      std::istringstream line{std::string(next_line())};
      std::string word;
      line >> word;
      if (word == "end_header") return;
      if (word == "format") {
        line >> word;
        ascii_ = word == "ascii";
        if (!ascii_ && word != "binary_little_endian") fail("format " + word + " is not supported");
      } else if (word == "element") {
        Element element;
        if (!(line >> element.name >> element.count)) fail("has a bad element line");
        elements_.push_back(std::move(element));
      } else if (word == "property") {
        if (elements_.empty()) fail("has a property before any element");
        elements_.back().properties.push_back(read_property(line));
      }
    }
  }

  Property read_property(std::istringstream& line) const {
    const auto scalar = [this](const std::string& word) {
      const auto found = scalar_names().find(word);
      if (found == scalar_names().end()) fail("has a property of unknown type " + word);
      return found->second;
    };
    Property property;
    std::string word;
    line >> word;
    if (word == "list") {
      line >> word;
      property.count = scalar(word);
      line >> word;
    }
    property.type = scalar(word);
    if (!(line >> property.name)) fail("has a bad property line");
    return property;
  }

  std::string_view next_line() {
    const std::size_t end = data_.find('\n', place_);
    if (end == std::string::npos) fail("is not a whole PLY file");
    std::string_view line(data_.data() + place_, end - place_);
    place_ = end + 1;
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    return line;
  }

  template <class Value>
  double take() {
    if (data_.size() - place_ < sizeof(Value)) fail("is shorter than its header says");
    Value value;
    std::memcpy(&value, data_.data() + place_, sizeof value);
    place_ += sizeof value;
    return static_cast<double>(value);
  }

  double next_word() {
    place_ = data_.find_first_not_of(" \t\r\n", place_);
    if (place_ == std::string::npos) fail("is shorter than its header says");
    double value = 0;
    const char* begin = data_.data() + place_;
    const auto [end, error] = std::from_chars(begin, data_.data() + data_.size(), value);
    if (error != std::errc()) fail("has a word where a number should be");
    place_ = static_cast<std::size_t>(end - data_.data());
    return value;
  }

  double next(Scalar type) {
    if (ascii_) return next_word();
    switch (type) {
      case Scalar::kInt8:
        return take<std::int8_t>();
      case Scalar::kUint8:
        return take<std::uint8_t>();
      case Scalar::kInt16:
        return take<std::int16_t>();
      case Scalar::kUint16:
        return take<std::uint16_t>();
      case Scalar::kInt32:
        return take<std::int32_t>();
      case Scalar::kUint32:
        return take<std::uint32_t>();
      case Scalar::kFloat:
        return take<float>();
      case Scalar::kDouble:
        return take<double>();
    }
    return 0;
  }

  std::uint32_t next_index(Scalar type) {
    const double value = next(type);
    if (!(value >= 0 && value <= std::numeric_limits<std::uint32_t>::max())) {
      fail("a face names a vertex that is not there");
    }
    return static_cast<std::uint32_t>(value);
  }

  void read_entry(const Element& element, TriangleMesh& mesh) {
    Eigen::Vector3d position = Eigen::Vector3d::Constant(std::nan(""));
    for (const Property& property : element.properties) {
      if (!property.count) {
        const double value = next(property.type);
        if (property.name == "x") position.x() = value;
        if (property.name == "y") position.y() = value;
        if (property.name == "z") position.z() = value;
        continue;
      }
      const bool corners = element.name == "face" &&
                           (property.name == "vertex_indices" || property.name == "vertex_index");
      const std::uint32_t count = next_index(*property.count);
      std::array<std::uint32_t, 3> triangle{};
      for (std::uint32_t i = 0; i < count; ++i) {
        const std::uint32_t index = corners ? next_index(property.type) : 0;
        if (!corners) next(property.type);
        triangle[std::min(i, 2U)] = index;
        if (corners && i >= 2) {
          mesh.triangles.push_back(triangle);
          triangle[1] = index;
        }
      }
    }
    if (element.name != "vertex") return;
    if (!position.allFinite()) fail("has a vertex without x, y and z");
    mesh.vertices.push_back(position);
  }

  std::string path_;
  std::string data_;
  std::size_t place_ = 0;
  bool ascii_ = false;
  std::vector<Element> elements_;
};

}  // namespace

TriangleMesh read_surface(const std::string& path) { return PlyReader(path).read(); }

std::vector<Eigen::Vector3d> sample_surface(const TriangleMesh& mesh, std::size_t count) {
  std::vector<double> area_up_to;
  double area = 0;
  for (const auto& [a, b, c] : mesh.triangles) {
    area += (mesh.vertices[b] - mesh.vertices[a]).cross(mesh.vertices[c] - mesh.vertices[a]).norm();
    area_up_to.push_back(area);
  }
  std::vector<Eigen::Vector3d> points;
  if (!(area > 0)) return points;
  const CounterRandom random(0, 0);
  for (std::size_t i = 0; i < count; ++i) {
    // One in each of as many equal parts of the area, anywhere in its triangle.
    const double wanted = area * (static_cast<double>(i) + 0.5) / static_cast<double>(count);
    const auto place = std::lower_bound(area_up_to.begin(), area_up_to.end(), wanted);
    const auto& [a, b, c] = mesh.triangles[static_cast<std::size_t>(place - area_up_to.begin())];
    const double root = std::sqrt(random.uniform(2 * i));
    const double share = random.uniform(2 * i + 1);
    points.push_back((1 - root) * mesh.vertices[a] + root * (1 - share) * mesh.vertices[b] +
                     root * share * mesh.vertices[c]);
  }
  return points;
}

Eigen::Vector3d nearest_on_triangle(const Eigen::Vector3d& point, const Eigen::Vector3d& a,
                                    const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  const Eigen::Vector3d ab = b - a;
  const Eigen::Vector3d ac = c - a;
  const Eigen::Vector3d ap = point - a;
  const double d1 = ab.dot(ap);
  const double d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const Eigen::Vector3d bp = point - b;
  const double d3 = ab.dot(bp);
  const double d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + d1 / (d1 - d3) * ab;
  const Eigen::Vector3d cp = point - c;
  const double d5 = ab.dot(cp);
  const double d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
  }
  const double sum = va + vb + vc;
  return a + vb / sum * ab + vc / sum * ac;
}

struct TrueSurface::Tree {
  explicit Tree(const TriangleMesh& mesh) {
    // One thread builds the tree, so that it is the same tree on every machine.
    device = rtcNewDevice("threads=1");
    if (device == nullptr) throw std::runtime_error("Embree cannot be started on this machine");
    scene = rtcNewScene(device);
    rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* coordinates = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                3 * sizeof(float), mesh.vertices.size()));
    auto* corners = static_cast<std::uint32_t*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(std::uint32_t), mesh.triangles.size()));
    if (coordinates == nullptr || corners == nullptr) throw std::bad_alloc();
    for (const Eigen::Vector3d& vertex : mesh.vertices) {
      for (const double value : vertex) *coordinates++ = static_cast<float>(value);
    }
    for (const auto& triangle : mesh.triangles) {
      corners = std::copy(triangle.begin(), triangle.end(), corners);
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene);
  }
  ~Tree() {
    rtcReleaseScene(scene);
    rtcReleaseDevice(device);
  }
  Tree(const Tree&) = delete;
  Tree& operator=(const Tree&) = delete;

  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
};

namespace {

struct NearestQuery {
  const TriangleMesh& mesh;
  Eigen::Vector3d point;
  Eigen::Vector3d nearest = Eigen::Vector3d::Zero();
  double distance2 = std::numeric_limits<double>::infinity();
  std::uint32_t triangle = 0;
};

// Embree brings the triangles within the radius, which shrinks to what has been found.
bool look_at_triangle(RTCPointQueryFunctionArguments* arguments) {
  // The tree's corners are rounded to floats: what is about as near must still be looked at.
  constexpr double kMargin = 1 + 1e-5;
  constexpr double kRounding = 1e-7;
  auto& query = *static_cast<NearestQuery*>(arguments->userPtr);
  const auto& [a, b, c] = query.mesh.triangles[arguments->primID];
  const Eigen::Vector3d nearest = nearest_on_triangle(
      query.point, query.mesh.vertices[a], query.mesh.vertices[b], query.mesh.vertices[c]);
  const double distance2 = (nearest - query.point).squaredNorm();
  if (distance2 > query.distance2 ||
      (distance2 == query.distance2 && arguments->primID > query.triangle)) {
    return false;
  }
  query.nearest = nearest;
  query.distance2 = distance2;
  query.triangle = arguments->primID;
  const double reach = kRounding * (query.point.cwiseAbs().maxCoeff() + 1);
  arguments->query->radius = static_cast<float>(kMargin * std::sqrt(distance2) + reach);
  return true;
}

}  // namespace

TrueSurface::TrueSurface(TriangleMesh mesh) : mesh_(std::move(mesh)) {
  if (mesh_.triangles.empty()) throw std::invalid_argument("a surface needs triangles");
  tree_ = std::make_unique<Tree>(mesh_);
}

TrueSurface::~TrueSurface() = default;

Eigen::Vector3d TrueSurface::nearest(const Eigen::Vector3d& point) const {
  const Eigen::Vector3f rounded = point.cast<float>();
  RTCPointQuery place{};
  place.x = rounded.x();
  place.y = rounded.y();
  place.z = rounded.z();
  place.radius = std::numeric_limits<float>::infinity();
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  NearestQuery query{mesh_, point};
  rtcPointQuery(tree_->scene, &place, &context, look_at_triangle, &query);
  return query.nearest;
}

bool TrueSurface::sees(const Eigen::Vector3d& eye, const Eigen::Vector3d& point) const {
  constexpr float kShortOfThePoint = 0.999F;
  const Eigen::Vector3f origin = eye.cast<float>();
  const Eigen::Vector3f way = (point - eye).cast<float>();
  RTCRay ray{};
  ray.org_x = origin.x();
  ray.org_y = origin.y();
  ray.org_z = origin.z();
  ray.dir_x = way.x();
  ray.dir_y = way.y();
  ray.dir_z = way.z();
  ray.tfar = kShortOfThePoint;
  ray.mask = std::numeric_limits<unsigned>::max();
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(tree_->scene, &context, &ray);
  return ray.tfar > 0;
}

}  // namespace gastronaut::evaluation
