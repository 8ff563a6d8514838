// abcal-mpi: `abcal uncertainty` for several processes (mpirun). A program of its own, so that abcal need not
// load MPI.
#include "app/commands/uncertainty.h"
#include "app/run_program.h"
#include "app/studies/trials/mpi_team.h"

int main(int argc, char** argv) {
  using namespace abcal;
  return run_program(argc, argv,
                     {"abcal-mpi",
                      "abcal-mpi shares one Monte Carlo study of `abcal uncertainty` among the processes "
                      "that mpirun starts:\n  mpirun -n 4 abcal-mpi uncertainty RUN",
                      [](CLI::App& app, int& exit_code) {
                        add_uncertainty(app, exit_code, {mpi_team, abandon});
                      }});
}
