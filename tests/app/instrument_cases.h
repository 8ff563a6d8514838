#pragma once

#include <ostream>
#include <string>
#include <vector>

#include "drivers/registry.h"
#include "tests/app/stage_variants.h"

namespace abcal {

struct StageCase {
  std::string name;
  std::string sections;  ///< [stage] and its axes; the ports read PORT, PORTX, PORTZ.
};

struct AccelerometerCase {
  std::string name;
  std::string section;  ///< [accelerometer] without its port.
  double scale = 1.0;   ///< Response unit per g_loc.
  double noise = 1e-4;  ///< Noise of one reading, in g_loc.
};

// The names of the tests carry the parameters: as words, not as bytes.
inline void PrintTo(const StageCase& stage, std::ostream* out) {
  *out << stage.name;
}
inline void PrintTo(const AccelerometerCase& accelerometer, std::ostream* out) {
  *out << accelerometer.name;
}

/// Every stage driver of the registry, and the two kinds of controller side by side.
inline const std::vector<StageCase>& stages() {
  static const std::vector<StageCase> all = [] {
    std::vector<StageCase> cases;
    for (const StageDriver& driver : stage_drivers())
      cases.push_back({driver.name, "[stage]\ndriver = \"" + driver.name + "\"\nport = \"PORT\"\n"});
    cases.push_back({"pi_chain",
                     "[stage]\ndriver = \"pi_gcs\"\nport = \"PORT\"\n"
                     "[stage.x]\naxis = \"1 1\"\n[stage.z]\naxis = \"2 1\"\n"});
    cases.push_back({"zaber_chain",
                     "[stage]\ndriver = \"zaber_ascii\"\nport = \"PORT\"\n"
                     "[stage.x]\naxis = \"1 1\"\n[stage.z]\naxis = \"2 1\"\n"});
    cases.push_back({"two_controllers",
                     "[stage.x]\ndriver = \"newport_esp\"\nport = \"PORTX\"\naxis = \"1\"\n"
                     "[stage.z]\ndriver = \"pi_gcs\"\nport = \"PORTZ\"\naxis = \"1\"\n"});
    return cases;
  }();
  return all;
}

/// Every shipped description of a stage, on the emulator that is made of it.
inline const std::vector<StageCase>& described_stages() {
  static const std::vector<StageCase> all = [] {
    std::vector<StageCase> cases;
    for (const StageVariant& variant : stage_variants())
      if (!variant.description.empty())
        cases.push_back({variant.name, "[stage]\nport = \"PORT\"\n" + variant.section()});
    return cases;
  }();
  return all;
}

/// Every accelerometer driver of the registry.
inline const std::vector<AccelerometerCase>& accelerometers() {
  static const std::vector<AccelerometerCase> all = [] {
    std::vector<AccelerometerCase> cases;
    for (const AccelerometerDriver& driver : accelerometer_drivers()) {
      AccelerometerCase one{driver.name, "driver = \"" + driver.name + "\"\n" + driver.example};
      if (driver.output_unit == "m/s2") one.scale = 9.81;
      // 16 g over 32768 counts: the noise must be a few counts, or averaging does not resolve them.
      if (driver.name == "witmotion") one.noise = 2e-3;
      cases.push_back(one);
    }
    return cases;
  }();
  return all;
}

inline std::string replaced(std::string text, const std::string& what, const std::string& with) {
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + with.size()))
    text.replace(at, what.size(), with);
  return text;
}

/// A bench quick enough for a test, whose accelerometer is neither ideal nor aligned nor adjusted to better
/// than 5 %.
inline std::string bench_text(const StageCase& stage, const AccelerometerCase& accelerometer,
                              const std::string& stage_port, const std::string& stage_x_port,
                              const std::string& stage_z_port, const std::string& accelerometer_port) {
  const double k = accelerometer.scale;
  std::string sections = replaced(stage.sections, "PORTX", stage_x_port);
  sections = replaced(sections, "PORTZ", stage_z_port);
  sections = replaced(sections, "PORT", stage_port);
  const auto row = [&](double a, double b, double c) {
    return "[" + std::to_string(k * a) + ", " + std::to_string(k * b) + ", " + std::to_string(k * c) + "]";
  };
  return "[bench]\ng_loc_mps2 = 9.81\n[item]\nsensitivity_tolerance = 0.05\n" + sections +
         "[accelerometer]\nport = \"" + accelerometer_port + "\"\n" + accelerometer.section +
         "[protocol]\ncheck_poses = false\nsteps = 12\nstep_deg = 30.0\nsettle_s = 0.05\ndwell_readings = "
         "10\n[simulation]\nseed "
         "= "
         "3\nsensitivity_matrix = [" +
         row(1.01, 0.02, -0.01) + ", " + row(-0.03, 0.98, 0.02) + ", " + row(0.01, -0.02, 1.0) +
         "]\noffset = " + row(0.01, -0.02, 0.03) + "\nnoise = " + std::to_string(k * accelerometer.noise) +
         "\nzx = 5e-5\nzy = -1e-4\nxz = 1e-4\n"
         "[simulation.x]\nspeed_deg_per_s = 700.0\nacceleration_deg_per_s2 = 20000.0\nstep_error_deg = "
         "0.005\n"
         "[simulation.z]\nspeed_deg_per_s = 700.0\nacceleration_deg_per_s2 = 20000.0\nstep_error_deg = "
         "0.005\n";
}

}  // namespace abcal
