#pragma once

#include <stdexcept>
#include <string>

#include "tests/support/program.h"
#include "tests/support/project_paths.h"

namespace abcal::test {

inline void replace_in(std::string& text, const std::string& what, const std::string& by) {
  const std::size_t at = text.find(what);
  if (at == std::string::npos) throw std::runtime_error("tray.toml has no " + what);
  text.replace(at, what.size(), by);
}

/// The bench file of the example with the first three of its items, and few angles. All is simulated.
inline std::string small_tray() {
  std::string text = read_file(source_folder() / "docs/examples/tray.toml");
  text.resize(text.rfind("[[item]]", text.find("# item 4")));
  replace_in(text, "steps = 24\nstep_deg = 15.0", "steps = 12\nstep_deg = 30.0");
  replace_in(text, "dwell_readings = 300", "dwell_readings = 50");
  return text;
}

}  // namespace abcal::test
