// abcal-guard: opens the ports of a stage and a chamber for the program that moves them, passes the bytes on,
// and halts the axes and leaves the chamber as its policy states if that program dies or hangs
// (app/measure/guard/guard_service.h). Started by abcal, with one end of a socket as descriptor 3.
#include <sys/resource.h>

#include <csignal>
#include <exception>
#include <string>
#include <string_view>

#include "app/measure/guard/guard_service.h"
#include "app/system/boot_clock.h"
#include "app/system/output.h"
#include "app/system/real_clock.h"
#include "app/system/version.h"
#include "drivers/wire/open_stream.h"

int main(int argc, char** argv) {
  if (argc == 2 && std::string_view(argv[1]) == "--version") {
    abcal::print_result("abcal-guard {}\n", abcal::program_version());
    return 0;
  }
  // Signals that end the owner (Ctrl-C, a closed terminal, the end of a service) must not end the guard as
  // well.
  for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGPIPE, SIGQUIT}) std::signal(number, SIG_IGN);
  // Where this user may: on a busy machine it is the last that should wait.
  (void)::setpriority(PRIO_PROCESS, 0, -10);
  try {
    abcal::RealClock clock;
    abcal::GuardService::Options options;
    options.socket = 3;
    options.open = [&clock](const abcal::PortRequest& request) {
      return abcal::wire::open_stream(request.port, request.serial, clock, request.holder);
    };
    options.uptime = abcal::uptime;
    abcal::GuardService guard(clock, std::move(options));
    for (const std::string& words : guard.serve())
      abcal::print_log("abcal-guard: the program that moved the bench has ended; {}\n", words);
    return 0;
  } catch (const std::exception& error) {
    abcal::print_log("abcal-guard: {}\n", error.what());
    return 1;
  }
}
