#pragma once

#include <string>

#include "app/document/document.h"

namespace abcal {

/// The pages of a certificate, made of its XML and of nothing else, in its language: two for the customer
/// (results with U and k, decisions, conditions, traceability, statements, signatures), and an annex with
/// everything else. Numbers are those of the XML, typeset.
/// @throws std::runtime_error  for a text that is not the XML of a certificate
Document certificate_page(const std::string& xml);

}  // namespace abcal
