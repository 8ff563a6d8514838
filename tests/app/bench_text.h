#pragma once

#include <string>

namespace abcal {

/// A bench file of a PI stage and a MicroStrain accelerometer (or others), quick enough for a test.
struct BenchText {
  std::string stage_driver = "pi_gcs";
  std::string accelerometer_driver = "microstrain_mip";
  std::string stage_port = "simulated";
  std::string accelerometer_port = "simulated";
  bool check_poses = false;  ///< The plan as published, where a test counts angles.
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
