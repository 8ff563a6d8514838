#pragma once

#include <CLI/CLI.hpp>

#include "app/laboratory/certificate/report_certificate.h"

namespace abcal {

/// Adds --laboratory, --as-found, --schemas and --language to a command that makes a certificate.
void add_certificate_options(CLI::App& command, CertificateFiles& files);

}  // namespace abcal
