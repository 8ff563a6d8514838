#pragma once

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// The series over temperature of a certificate as a measurement result of its own: conditions of all its
/// runs; range, points, temperature coefficients, polynomials with covariance, differences between the ways
/// and closure; and which runs these are, by the SHA-256 of each.
/// @throws NumberNotFinite
void add_temperature_series(XmlElement& measurements, const Certificate& certificate);

}  // namespace abcal
