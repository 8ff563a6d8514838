// In place of mpi_team.cc where the program is built without MPI.

#include <cstdlib>
#include <stdexcept>

#include "app/commands/mpi_team.h"

namespace abcal {

std::unique_ptr<MonteCarloTeam> mpi_team() {
  if (std::getenv("OMPI_COMM_WORLD_SIZE") == nullptr && std::getenv("PMIX_RANK") == nullptr) return nullptr;
  throw std::runtime_error(
      "this abcal was built without MPI, so that under mpirun each process would do the whole study; found: "
      "mpirun; required: a build with libopenmpi-dev installed, or abcal alone");
}

void abandon(MonteCarloTeam*, const char*, int) {}

}  // namespace abcal
