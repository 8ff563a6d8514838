#pragma once

#include <CLI/CLI.hpp>
#include <filesystem>
#include <functional>
#include <memory>

#include "protocol/uncertainty/monte_carlo_team.h"
#include "protocol/uncertainty/type_a.h"

namespace abcal {

/// How several processes share one study.
struct StudyProcesses {
  /// The team of this process; null for a process alone. @throws std::runtime_error if it cannot be made
  std::function<std::unique_ptr<MonteCarloTeam>()> join;
  /// Ends the processes of the team after a failure in this one; does nothing without a team.
  std::function<void(MonteCarloTeam*, const char* why, int exit_code)> abandon;
};

/// Processes of `abcal`: always one. Under mpirun, where every process would run and print the whole study,
/// `join` throws std::runtime_error and names `abcal-mpi`.
StudyProcesses one_process();

/// `abcal uncertainty RUN|FILE.csv`: budget and Monte Carlo of the result of the declared estimator, or of
/// another with `--estimator`. Bad options throw std::invalid_argument.
CLI::App* add_uncertainty(CLI::App& parent, int& exit_code, StudyProcesses processes);

}  // namespace abcal
