#pragma once

#include <optional>
#include <string>

#include "app/certificate/certificate.h"
#include "app/document/document.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// Turns a report into the page of a certificate: title, number, DRAFT across every page until it is issued;
/// in front of the results laboratory, customer, persons, dates, item's condition, equipment, and behind them
/// decisions, derived quantities, as found and as left, and the statements (ISO/IEC 17025 7.8.2 to 7.8.8).
void add_certificate_sections(Document& document, const Certificate& certificate);

}  // namespace abcal
