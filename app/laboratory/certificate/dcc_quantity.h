#pragma once

#include <string>

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/words.h"

namespace abcal {

// The elements that results are made of.

/// Adds a dcc:result. @return its dcc:data
XmlElement add_result(XmlElement& results, const std::string& ref_type, const Wording& name,
                      const Wording& description = {});

/// Adds a dcc:quantity with its name.
XmlElement add_quantity(XmlElement& parent, const std::string& ref_type, const Wording& name);

/// Adds which of the quantities have an uncertainty that was raised to the scope's, and which are outside of
/// it.
void add_scope_marks(XmlElement& metadata, const Words& words, const std::vector<std::string>& labels,
                     const std::vector<ScopeMark>& marks);

/// Adds a list of measured values, with low degrees of freedom and the marks of the scope.
/// @return the quantity
/// @throws NumberNotFinite
XmlElement add_list(XmlElement& parent, const Words& words, const Wording& name, const ValueList& list);

/// Adds a number without uncertainty in a unit of ours. @param number  as dsi_number() writes it
void add_number(XmlElement& data, const std::string& ref_type, const Wording& name, const std::string& number,
                const std::string& unit);

}  // namespace abcal
