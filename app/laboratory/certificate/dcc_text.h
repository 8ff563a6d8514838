#pragma once

#include <string>
#include <string_view>

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/words.h"

namespace abcal {

/// Adds an element of a sentence or name of ours, in its language.
XmlElement add_words(XmlElement& parent, std::string_view element, const Wording& words);

/// Adds such a sentence as text within dcc:data.
void add_text(XmlElement& parent, const Wording& words);

/// Adds a dcc:metaData with its name.
XmlElement add_metadatum(XmlElement& list, std::string_view ref_type, const Wording& name);

/// Source of a size or of an input of the budget. Only the program's own words for it are translated; a
/// source that a person wrote stays as it is.
Wording source_words(const Words& words, const std::string& source);

/// Adds an element with a name that belongs to no language.
XmlElement add_name(XmlElement& parent, std::string_view element, std::string_view name);

/// Adds an element whose text must not be empty and is one line; adds nothing if the text is empty.
void add_line(XmlElement& parent, std::string_view element, std::string_view text);

/// Adds software with its release as the business rules require it ("v1.0.0") and its version in full.
void add_software(XmlElement& list, const Words& words, std::string_view name, const std::string& version);

/// Adds an identification: issuer, value and name; nothing without a value.
void add_identification(XmlElement& list, std::string_view issuer, std::string_view value,
                        const Wording& name);

/// Adds a referral to another document by the hash of its file.
void add_hash(XmlElement& parent, std::string_view element, const Wording& words, std::string_view id,
              std::string_view sha256);

}  // namespace abcal
