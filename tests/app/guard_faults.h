#pragma once

#include <fstream>
#include <set>
#include <string>

#include "drivers/text/names.h"
#include "tests/support/project_paths.h"

namespace abcal {

/// Faults of a program that moves a stage, of its guard and of the port between.
enum class FaultKind {
  kKillProgram,
  kFreezeProgram,
  kEndProgram,      ///< Ctrl-C, SIGTERM, the end of a jog.
  kSuspendProgram,  ///< Ctrl-Z.
  kKillGuard,
  kFreezeGuard,
  kUnplug,  ///< The port is gone, and comes back at any time later.
};

inline constexpr auto kFaults = names<FaultKind>({{FaultKind::kKillProgram, "program killed"},
                                                  {FaultKind::kFreezeProgram, "program frozen"},
                                                  {FaultKind::kEndProgram, "program ended"},
                                                  {FaultKind::kSuspendProgram, "program suspended"},
                                                  {FaultKind::kKillGuard, "guard killed"},
                                                  {FaultKind::kFreezeGuard, "guard frozen"},
                                                  {FaultKind::kUnplug, "port gone"}});

/// Pairs of faults that leave an axis moving, by the table of docs/halting.md: "| program killed | guard
/// frozen | ..." in docs/halting.md, in both orders.
inline std::set<std::string> named_losses() {
  std::set<std::string> named;
  std::ifstream page(test::source_folder() / "docs/halting.md");
  for (std::string line; std::getline(page, line);) {
    if (!line.starts_with("| program ")) continue;
    const std::size_t second = line.find(" | ") + 3;
    const std::string a = line.substr(2, second - 5),
                      b = line.substr(second, line.find(" |", second) - second);
    named.insert(a + ", " + b);
    named.insert(b + ", " + a);
  }
  return named;
}

}  // namespace abcal
