#pragma once

#include <filesystem>
#include <string>

namespace abcal {

/// The bench file of `abcal demo`: docs/examples/emulated.toml with the ports in `folder` and fewer angles.
/// @param folder  absolute
/// @param steps  angles of each experiment
/// @throws std::invalid_argument if a step is not a whole number of degrees
std::string demo_bench(const std::filesystem::path& folder, int steps);

/// The same bench with the emulated instruments inside the program that reads it.
/// @throws as demo_bench()
std::string demo_bench_in_process(int steps);

/// Conditions, plan and simulated truth of the same example: the part of a bench file that an emulated bench
/// needs besides its instruments.
std::string emulated_sections();

/// Writes the bench file into the folder, as "bench.toml" or under the first free name: a file of another
/// content stays as it is.
/// @return its path
std::filesystem::path write_demo_bench(const std::filesystem::path& folder, int steps);

}  // namespace abcal
