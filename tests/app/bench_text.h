#pragma once

#include <string>

namespace abcal {

/// Plan and simulation of an item with all errors, quick enough for a test: the end of a bench file.
/// @param simulation  lines of [simulation] in addition
inline std::string quick_calibration(const std::string& simulation = "") {
  return R"([protocol]
check_poses = false
steps = 12
step_deg = 30.0
settle_s = 0.05
dwell_readings = 10
[simulation]
)" + simulation +
         R"(noise = 1e-4
quantisation = 1e-6
sensitivity_matrix = [[1.0021, -0.0047, 0.0037], [0.0069, 0.9982, 0.0086], [-0.0117, 0.0064, 1.0009]]
offset = [0.01, 0.02, 0.03]
[simulation.x]
speed_deg_per_s = 700.0
acceleration_deg_per_s2 = 20000.0
step_error_deg = 0.005
[simulation.z]
speed_deg_per_s = 700.0
acceleration_deg_per_s2 = 20000.0
step_error_deg = 0.005
)";
}

/// A bench file of a PI stage and a MicroStrain accelerometer (or others), quick enough for a test.
struct BenchText {
  std::string stage_driver = "pi_gcs";
  std::string accelerometer_driver = "microstrain_mip";
  std::string stage_port = "simulated";
  std::string accelerometer_port = "simulated";
  bool check_poses = false;  ///< False: the published plan, for tests that count angles.
  std::string protocol = "steps = 12\nstep_deg = 30.0\nsettle_s = 0.05\ndwell_readings = 10\n";
  std::string simulation;
  std::string motion = "speed_deg_per_s = 700.0\nacceleration_deg_per_s2 = 20000.0\n";

  std::string text() const {
    return "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"" + stage_driver + "\"\nport = \"" + stage_port +
           "\"\n[accelerometer]\ndriver = \"" + accelerometer_driver + "\"\nport = \"" + accelerometer_port +
           "\"\nrate_hz = 200.0\n[protocol]\n" + (check_poses ? "" : "check_poses = false\n") + protocol +
           "[simulation]\nnoise = 1e-4\noffset = [0.01, 0.02, 0.03]\n" + simulation + "[simulation.x]\n" +
           motion + "step_error_deg = 0.005\n[simulation.z]\n" + motion + "step_error_deg = 0.005\n";
  }
};

}  // namespace abcal
