#pragma once

#include <memory>

#include "protocol/uncertainty/monte_carlo_team.h"

namespace abcal {

/// The processes that `mpirun -n K abcal ...` started, or null outside of mpirun, or with a program that was
/// built without MPI (which under mpirun throws, as every process would do the whole study and print it).
/// Process 0 leads. Ends MPI when it is destroyed.
/// @throws std::runtime_error if the MPI library cannot serve several threads, or is not built in.
std::unique_ptr<MonteCarloTeam> mpi_team();

/// Ends the processes of the team, as the others would wait for this one for ever. Says why on standard
/// error. Does nothing without a team; does not return with one.
void abandon(MonteCarloTeam* team, const char* why, int exit_code);

}  // namespace abcal
