#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "app/system/child_process.h"

namespace abcal {

/// A program that belongs to abcal: in the folder of the running program, or installed in ../libexec/abcal
/// from there; never searched for in PATH.
Tool helper_program(const std::string& name, const std::string& needed_by);

/// Runs a helper program to its end. Its output is the message of its failure.
/// @throws std::invalid_argument if it ends with kExitUsage, ProgramMissing, RunInterrupted,
/// std::runtime_error
void run_helper(const std::string& name, const std::string& needed_by,
                const std::vector<std::string>& arguments, std::chrono::seconds longest = kLongestTool);

/// Runs a helper program that reads its standard input. Otherwise as run_helper().
/// @param cancelled  asked each 0.1 s; true ends the program
/// @throws as run_helper()
void run_helper_on(std::string_view input, const std::string& name, const std::string& needed_by,
                   const std::vector<std::string>& arguments, const std::function<bool()>& cancelled = {});

/// A folder of data that belongs to abcal: in the folder of the running program, or installed in
/// ../share/abcal from there.
std::filesystem::path program_data(const std::string& name);

/// The folder of the helper programs for tests, whose own programs are elsewhere.
void set_helper_folder(std::filesystem::path folder);

}  // namespace abcal
