#pragma once

#include <memory>

#include "protocol/uncertainty/monte_carlo_team.h"

namespace abcal {

/// The processes that `mpirun -n K abcal-mpi ...` started, or null outside of mpirun. Process 0 leads. Ends
/// MPI when it is destroyed.
/// @throws std::runtime_error if the MPI library cannot serve several threads.
std::unique_ptr<MonteCarloTeam> mpi_team();

/// Ends the processes of the team, as the others would wait for this one without end. Reports why on standard
/// error. Does nothing without a team; does not return with one.
void abandon(MonteCarloTeam* team, const char* why, int exit_code);

}  // namespace abcal
