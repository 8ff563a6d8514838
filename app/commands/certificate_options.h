#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "app/certificate/report_certificate.h"

namespace abcal {

/// Adds --laboratory, --as-found and --schemas to a command that makes a certificate.
void add_certificate_options(CLI::App& command, CertificateFiles& files);

/// A note on standard error; an empty one is not printed.
void print_note(const std::string& note);

}  // namespace abcal
