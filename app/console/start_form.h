#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "app/console/run_choice.h"
#include "app/console/run_library.h"
#include "drivers/instrument/clock.h"
#include "protocol/record/run_operator.h"

namespace abcal::console {

/// The data from which a start form is made.
struct StartFormAsked {
  std::filesystem::path bench_file, runs;
  std::string register_location;  ///< Empty: no register.
  RunOperator who;                ///< The person logged in on the page; no name: nobody.
  RunChoice choice;
};

/// The run that would be started: item, operator, plan, its duration and uncertainties as `abcal plan`
/// predicts them, free disk space, the last check; `warnings`, and `problems` that prevent the start. Takes
/// time: it opens the register and computes predictions. Nothing moves and no port is opened.
nlohmann::ordered_json start_form(const StartFormAsked& asked, RunLibrary& library, Clock::UtcTime now);

}  // namespace abcal::console
