#pragma once

#include <fmt/format.h>

#include <string>

namespace abcal {

/// A simulated bench in a simulated chamber.
struct SeriesText {
  std::string chamber = "driver = \"watlow_f4\"\nport = \"simulated\"\nhumidity = true\npause_output = 2\n";
  std::string temperature =
      "set_points_degc = [-40, 23, 85]\nramp_k_per_min = 5.0\nsoak_min_s = 1200\nsoak_max_s = 14400\n";
  std::string protocol =
      "steps = 8\nstep_deg = 45.0\ncheck_poses = false\nsettle_s = 0.1\ndwell_readings = 20\n";
  std::string world;  ///< More keys of [simulation].
  std::string more;   ///< Further keys of [simulation.chamber], and sections behind it.
  int seed = 3;

  std::string text() const {
    return fmt::format(
        "[bench]\ng_loc_mps2 = 9.81\n[item]\nsensitivity_tolerance = 0.1\n[stage]\ndriver = \"simulated\"\n"
        "[accelerometer]\ndriver = \"simulated\"\nresponse_unit = "
        "\"g\"\n[chamber]\n{}[temperature]\n{}[protocol]\n{}"
        "[stage_uncertainty]\nstep_smooth_deg = 0.0\nwobble_urad = "
        "0.0\n[item_uncertainty]\nsensitivity_drift = 0.0\n"
        "nonlinearity = 0.0\nhysteresis = 0.0\ndrift = 2e-5\n"
        "[simulation]\nseed = {}\nnoise = 1e-4\noffset = [0.01, -0.02, 0.03]\nzx = 2e-5\nxz = -2e-5\n"
        "sensitivity_per_degc = [-1e-4, 5e-5, 2e-5]\noffset_per_degc = [3e-5, -5e-5, 1e-5]\n{}"
        "[simulation.chamber]\nself_heating_degc = 3.0\n{}",
        chamber, temperature, protocol, seed, world, more);
  }
};

}  // namespace abcal
