#pragma once

#include <filesystem>
#include <string>

namespace abcal::test {

/// The folder of the project's sources. Known to one file only, so that a compiler cache serves all others in
/// whatever folder the project lies.
std::filesystem::path source_folder();

/// The program abcal of this build.
std::string abcal_program();

}  // namespace abcal::test
