#pragma once

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// Adds the uncertainty budget as a result: each input with its standard uncertainty, and its contribution to
/// the standard uncertainty of every output as the certificate states it: local gravity, and a raise to the
/// laboratory's scope, have lines of their own.
void add_budget(XmlElement& results, const Words& words, const Budget& budget, const CertifiedRun& run);

}  // namespace abcal
