#pragma once

#include <string_view>
#include <vector>

namespace abcal {

/// The table of a file of app/laboratory/certificate/languages, built into the program.
struct LanguageFile {
  std::string_view path;  ///< Code of the language: "de".
  std::string_view body;  ///< JSON: each English sentence with its translation.
};

const std::vector<LanguageFile>& language_files();

}  // namespace abcal
