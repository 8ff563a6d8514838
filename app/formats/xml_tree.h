#pragma once

#include <libxml/tree.h>

#include <memory>
#include <string>
#include <string_view>

namespace abcal {

struct FreeXml {
  void operator()(xmlDoc* document) const { xmlFreeDoc(document); }
};
/// A document of libxml2.
using XmlDocument = std::unique_ptr<xmlDoc, FreeXml>;

/// libxml2 names its strings unsigned char.
inline const xmlChar* as_xml(const char* text) {
  return reinterpret_cast<const xmlChar*>(text);
}

/// Text that any XML 1.0 document may hold: invalid UTF-8 and control characters become U+FFFD.
std::string xml_safe(std::string_view text);

/// Like xml_safe(), on one line: blanks at the ends are cut off, others become one space each. Many elements
/// of the certificate require this; empty stays empty.
std::string one_line(std::string_view text);

/// An element that is being filled. Names carry the prefix of a namespace that the root declares
/// ("dcc:name"). Markup in texts is escaped by libxml2.
class XmlElement {
 public:
  XmlElement() = default;
  explicit XmlElement(xmlNode* node) : node_(node) {}

  XmlElement add(std::string_view name);
  XmlElement add(std::string_view name, std::string_view text);
  XmlElement& attribute(const char* name, std::string_view value);
  xmlNode* node() const { return node_; }

 private:
  xmlNode* node_ = nullptr;
};

/// The document as UTF-8 text, indented.
std::string xml_text(const XmlDocument& document);

/// The largest text that parse_xml() accepts: a certificate has some 100 kB.
inline constexpr std::size_t kLargestXml = 12u << 20;

/// Parses a text. Nothing is loaded from the network or from other files; a text with a document type
/// declaration is refused, so that no entities can be expanded.
/// @throws std::runtime_error with the line
XmlDocument parse_xml(std::string_view text, const std::string& source);

}  // namespace abcal
