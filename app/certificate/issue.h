#pragma once

#include <optional>
#include <string>

#include "app/certificate/certificate.h"
#include "app/certificate/schema_check.h"
#include "app/certificate/sign.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// The XML of a certificate, checked by the business rules and by the schema.
/// @param schema  null: by the rules only, for tests
/// @throws CertificateRefused  with every violation: nothing is written then
std::string checked_xml(const Certificate& certificate, const DccSchema* schema);

/// Issues a certificate: its XML, signed if there is a key, is kept in RUN.results, where it can be neither
/// changed nor removed unnoticed. From then on every report of the run carries it as it was issued.
/// @param certificate  with its issue facts
/// @throws CertificateRefused, RunFileError (number given already, run replaced already),
/// std::invalid_argument
///         (key)
IssuedCertificate issue_certificate(const Certificate& certificate, const DccSchema* schema,
                                    const std::optional<SigningKey>& key, const std::string& utc);

/// The certificate that holds for an item of a run (1 where it has one): the last that was issued.
std::optional<IssuedCertificate> current_certificate(const std::filesystem::path& run, int item = 1);

}  // namespace abcal
