#pragma once

#include <filesystem>
#include <string>

#include "app/system/child_process.h"

namespace abcal {

/// A program that belongs to abcal: in the folder of the running program, or installed in ../libexec/abcal
/// from there; never looked for in PATH.
Tool helper_program(const std::string& name, const std::string& needed_by);

/// Where tests, whose programs lie elsewhere, have the helper programs.
void set_helper_folder(std::filesystem::path folder);

}  // namespace abcal
