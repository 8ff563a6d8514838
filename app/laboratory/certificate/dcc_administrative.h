#pragma once

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/certificate.h"

namespace abcal {

/// Adds dcc:dccSoftware and dcc:refTypeDefinitions.
void add_software_and_definitions(XmlElement& administrative, const Words& words,
                                  const std::string& program_version);

/// Adds dcc:calibrationLaboratory.
void add_laboratory(XmlElement& administrative, const Words& words, const Laboratory& laboratory);

/// Adds dcc:customer.
void add_customer(XmlElement& administrative, const Words& words, const Contact& customer);

/// Adds a person to dcc:respPersons, with the role that the laboratory file states.
void add_person(XmlElement& persons, const LaboratoryFile& laboratory, const std::string& name,
                const std::string& part, bool main_signer);

/// Adds persons, item, place, dates and the statements of a certificate (dcc:administrativeData).
void add_administrative_data(XmlElement& root, const Certificate& certificate);

}  // namespace abcal
