#include "app/laboratory/certificate/dcc_text.h"

#include "app/laboratory/certificate/dcc_xml.h"
#include "protocol/record/stage_record.h"
#include "protocol/uncertainty/budget.h"

namespace abcal {
namespace {

/// An element without text is not allowed.
std::string line_or_not_stated(std::string_view text) {
  std::string line = one_line(text);
  return line.empty() ? "not stated" : line;
}

}  // namespace

XmlElement add_words(XmlElement& parent, std::string_view element, const Wording& words) {
  XmlElement child = parent.add(element);
  XmlElement content = child.add("dcc:content", line_or_not_stated(words.text));
  if (!words.language.empty()) content.attribute("lang", words.language);
  return child;
}

void add_text(XmlElement& parent, const Wording& words) {
  XmlElement data = parent.add("dcc:data");
  add_words(data, "dcc:text", words);
}

XmlElement add_metadatum(XmlElement& list, std::string_view ref_type, const Wording& name) {
  XmlElement metadatum = list.add("dcc:metaData");
  metadatum.attribute("refType", ref_type);
  add_words(metadatum, "dcc:name", name);
  return metadatum;
}

Wording source_words(const Words& words, const std::string& source) {
  if (source == kThisRun) return words("the readings of this run");
  if (source == "default") return words("a default that nobody stated");
  if (source == kStageRecordSource) return words("record of the stage");
  if (source.empty()) return words("not stated");
  // The readers of bench files enter these where a size has no source.
  if (source == "stated") return words("stated");
  if (source == "tolerances") return words("tolerances");
  return words.as_given(source);
}

XmlElement add_name(XmlElement& parent, std::string_view element, std::string_view name) {
  XmlElement child = parent.add(element);
  child.add("dcc:content", line_or_not_stated(name));
  return child;
}

void add_line(XmlElement& parent, std::string_view element, std::string_view text) {
  if (const std::string line = one_line(text); !line.empty()) parent.add(element, line);
}

std::string release_of(const std::string& program_version) {
  return "v" + program_version.substr(0, program_version.find(' '));
}

void add_software(XmlElement& list, const Words& words, std::string_view name, const std::string& version) {
  XmlElement software = list.add("dcc:software");
  add_name(software, "dcc:name", name);
  software.add("dcc:release", release_of(version));
  software.add("dcc:type", "application");
  add_words(software, "dcc:description", words("version and commit: {version}", one_line(version)));
}

void add_identification(XmlElement& list, std::string_view issuer, std::string_view value,
                        const Wording& name) {
  if (one_line(value).empty()) return;
  XmlElement identification = list.add("dcc:identification");
  identification.add("dcc:issuer", issuer);
  identification.add("dcc:value", one_line(value));
  add_words(identification, "dcc:name", name);
}

void add_hash(XmlElement& parent, std::string_view element, const Wording& words, std::string_view id,
              std::string_view sha256) {
  XmlElement hash = parent.add(element);
  add_words(hash, "dcc:referral", words);
  add_line(hash, "dcc:referralID", id);
  hash.add("dcc:procedure", "SHA-256");
  add_line(hash, "dcc:value", sha256);
}

}  // namespace abcal
