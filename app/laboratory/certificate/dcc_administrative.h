#pragma once

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// Adds persons, item, place, dates and the statements of a certificate (dcc:administrativeData).
void add_administrative_data(XmlElement& root, const Certificate& certificate);

}  // namespace abcal
