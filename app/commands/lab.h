#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>

#include "app/laboratory/register/login.h"

namespace abcal {

/// Options common to the commands of `abcal lab`.
struct LabOptions {
  std::string location;  ///< --register
};

/// The register that is configured. @throws std::invalid_argument if none is
lab::Register open_register(const LabOptions& options);

/// Each adds its commands to `abcal lab`.
void add_lab_people(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code);
void add_lab_records(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code);
void add_lab_charts(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code);
void add_lab_withdraw(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code);
void add_lab_copies(CLI::App& parent, const std::shared_ptr<LabOptions>& shared, int& exit_code);

/// Adds `abcal lab timestamp`, which needs no register.
void add_lab_time_stamp(CLI::App& parent, int& exit_code);

/// Adds `abcal lab sign`, which needs no register either.
void add_lab_sign(CLI::App& parent, int& exit_code);

}  // namespace abcal
