// Names of the channels of architecture.md; lcmtypes/README.md is the table for readers.
#pragma once

namespace gastronaut::channel {

inline constexpr const char* kCamera = "CAMERA";
inline constexpr const char* kHallArray = "HALL_ARRAY";
inline constexpr const char* kCoilCurrents = "COIL_CURRENTS";
inline constexpr const char* kRigConfig = "RIG_CONFIG";
inline constexpr const char* kMagneticPose = "MAGNETIC_POSE";
inline constexpr const char* kDepth = "DEPTH";
inline constexpr const char* kAlbedo = "ALBEDO";
inline constexpr const char* kVessels = "VESSELS";
inline constexpr const char* kVisualPose = "VISUAL_POSE";
inline constexpr const char* kCapsuleState = "CAPSULE_STATE";
inline constexpr const char* kCapsulePose = "CAPSULE_POSE";
inline constexpr const char* kMapSurfels = "MAP_SURFELS";
inline constexpr const char* kMapDeformation = "MAP_DEFORMATION";
inline constexpr const char* kOctomap = "OCTOMAP";
inline constexpr const char* kProcessStatus = "PROCESS_STATUS";
inline constexpr const char* kGroundTruthPose = "GROUND_TRUTH_POSE";
inline constexpr const char* kGroundTruthDepth = "GROUND_TRUTH_DEPTH";

}  // namespace gastronaut::channel
