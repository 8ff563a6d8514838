// abcal-guard: holds the ports of a stage and a chamber for the program that moves them, halts the axes and
// leaves the chamber as its policy says if that program dies (app/operate/bench/halt_guard.h). Started by
// abcal, with one end of a socket as descriptor 3.
#include <csignal>
#include <exception>
#include <string>
#include <string_view>
#include <vector>

#include "app/ground/system/output.h"
#include "app/ground/system/real_clock.h"
#include "app/ground/system/version.h"
#include "app/operate/bench/halt_guard.h"

int main(int argc, char** argv) {
  if (argc == 2 && std::string_view(argv[1]) == "--version") {
    abcal::print_result("abcal-guard {}\n", abcal::program_version());
    return 0;
  }
  // Signals that end the owner (Ctrl-C, a closed terminal, the end of a service) must not end the guard as
  // well.
  for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGPIPE, SIGQUIT}) std::signal(number, SIG_IGN);
  constexpr int kSocket = 3;
  try {
    abcal::RealClock clock;
    const std::vector<std::string> words = abcal::guard_until_owner_dies(kSocket, clock);
    for (const std::string& each : words)
      abcal::print_log("abcal-guard: the program that moved the bench has died; {}\n", each);
    return 0;
  } catch (const std::exception& error) {
    abcal::print_log("abcal-guard: {}\n", error.what());
    return 1;
  }
}
