#pragma once

#include <string_view>
#include <vector>

namespace abcal {

/// A file of docs/examples, built into the program.
struct ExampleFile {
  std::string_view path;  ///< "emulated.toml"
  std::string_view body;
};

const std::vector<ExampleFile>& example_files();

}  // namespace abcal
