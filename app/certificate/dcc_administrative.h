#pragma once

#include "app/certificate/certificate.h"
#include "app/xml/xml_tree.h"

namespace abcal {

/// Adds persons, item, place, dates and the statements of a certificate (dcc:administrativeData).
void add_administrative_data(XmlElement& root, const Certificate& certificate);

}  // namespace abcal
