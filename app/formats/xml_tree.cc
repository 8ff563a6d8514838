#include "app/formats/xml_tree.h"

#include <fmt/format.h>
#include <libxml/SAX2.h>
#include <libxml/parser.h>
#include <libxml/parserInternals.h>
#include <libxml/xmlstring.h>

#include <algorithm>
#include <stdexcept>

namespace abcal {
namespace {

bool allowed_in_xml(int code) {
  return code == 0x9 || code == 0xA || code == 0xD || (code >= 0x20 && code <= 0xD7FF) ||
         (code >= 0xE000 && code <= 0xFFFD) || (code >= 0x10000 && code <= 0x10FFFF);
}

/// Bytes of a character in UTF-8. Longer encodings of the same character are not valid, though libxml2 reads
/// them.
int length_of(int code) {
  return code < 0x80 ? 1 : code < 0x800 ? 2 : code < 0x10000 ? 3 : 4;
}

bool is_blank(char c) {
  return c == ' ' || c == '\t' || c == '\n' || c == '\r';
}

}  // namespace

std::string xml_safe(std::string_view text) {
  constexpr std::string_view kReplacement = "\xEF\xBF\xBD";
  std::string safe;
  while (!text.empty()) {
    // libxml2 takes the largest number of bytes in `length`, and returns the length of the character in it.
    int length = static_cast<int>(std::min<std::size_t>(text.size(), 4));
    const std::string head(text.substr(0, static_cast<std::size_t>(length)));
    const int code = xmlGetUTF8Char(as_xml(head.c_str()), &length);
    if (code < 0 || length != length_of(code)) {
      safe += kReplacement;
      text.remove_prefix(1);
      continue;
    }
    const auto bytes = static_cast<std::size_t>(length);
    safe += allowed_in_xml(code) ? text.substr(0, bytes) : kReplacement;
    text.remove_prefix(bytes);
  }
  return safe;
}

std::string one_line(std::string_view text) {
  std::string line;
  bool gap = false;
  for (const char c : xml_safe(text)) {
    if (is_blank(c)) {
      gap = true;
      continue;
    }
    if (gap && !line.empty()) line += ' ';
    gap = false;
    line += c;
  }
  return line;
}

XmlElement XmlElement::add(std::string_view name) {
  const auto colon = name.find(':');
  const std::string prefix(name.substr(0, colon)), local(name.substr(colon + 1));
  xmlNs* space = xmlSearchNs(node_->doc, node_, as_xml(prefix.c_str()));
  if (space == nullptr) throw std::logic_error("no namespace has the prefix " + prefix);
  return XmlElement(xmlNewChild(node_, space, as_xml(local.c_str()), nullptr));
}

XmlElement XmlElement::add(std::string_view name, std::string_view text) {
  XmlElement child = add(name);
  // xmlNewChild would read the text as markup; a text node does not.
  xmlAddChild(child.node_, xmlNewDocText(node_->doc, as_xml(xml_safe(text).c_str())));
  return child;
}

XmlElement& XmlElement::attribute(const char* name, std::string_view value) {
  xmlNewProp(node_, as_xml(name), as_xml(xml_safe(value).c_str()));
  return *this;
}

std::string xml_text(const XmlDocument& document) {
  xmlChar* bytes = nullptr;
  int size = 0;
  xmlDocDumpFormatMemoryEnc(document.get(), &bytes, &size, "UTF-8", 1);
  if (bytes == nullptr) throw std::runtime_error("out of memory while the certificate was written");
  std::string text(reinterpret_cast<const char*>(bytes), static_cast<std::size_t>(size));
  xmlFree(bytes);
  return text;
}

namespace {

/// Each attribute has one; a certificate has some thousand.
constexpr std::size_t kMostEqualsSigns = 20'000;

/// Limits for documents from others.
struct Allowance {
  /// Elements and attributes: each takes some 250 bytes of memory.
  static constexpr std::size_t kMostParts = 100'000;
  std::size_t parts = 0;
  bool has_doctype = false;
};

Allowance& allowance_of(void* context) {
  return *static_cast<Allowance*>(static_cast<xmlParserCtxt*>(context)->_private);
}

/// Stops at a document type declaration, before any entity that it declares can be expanded.
void refuse_doctype(void* context, const xmlChar*, const xmlChar*, const xmlChar*) {
  allowance_of(context).has_doctype = true;
  xmlStopParser(static_cast<xmlParserCtxt*>(context));
}

void count_element(void* context, const xmlChar* name, const xmlChar* prefix, const xmlChar* uri,
                   int namespaces, const xmlChar** namespace_list, int attributes, int defaulted,
                   const xmlChar** attribute_list) {
  Allowance& allowance = allowance_of(context);
  allowance.parts += 1U + static_cast<std::size_t>(namespaces) + static_cast<std::size_t>(attributes);
  if (allowance.parts > Allowance::kMostParts) return xmlStopParser(static_cast<xmlParserCtxt*>(context));
  xmlSAX2StartElementNs(context, name, prefix, uri, namespaces, namespace_list, attributes, defaulted,
                        attribute_list);
}

struct FreeParser {
  void operator()(xmlParserCtxt* parser) const { xmlFreeParserCtxt(parser); }
};

}  // namespace

XmlDocument parse_xml(std::string_view text, const std::string& source) {
  if (text.size() > kLargestXml) {
    throw std::runtime_error(
        fmt::format("{}: {} bytes; required: at most {}", source, text.size(), kLargestXml));
  }
  // libxml2 compares each attribute of an element with all others before it reports the element.
  if (static_cast<std::size_t>(std::count(text.begin(), text.end(), '=')) > kMostEqualsSigns)
    throw std::runtime_error(fmt::format("{}: has more than {} attributes; required: at most that many",
                                         source, kMostEqualsSigns));
  const std::unique_ptr<xmlParserCtxt, FreeParser> parser(xmlNewParserCtxt());
  if (!parser) throw std::bad_alloc();
  Allowance allowance;
  parser->_private = &allowance;
  parser->sax->internalSubset = refuse_doctype;
  parser->sax->startElementNs = count_element;
  XmlDocument document(xmlCtxtReadMemory(parser.get(), text.data(), static_cast<int>(text.size()),
                                         source.c_str(), nullptr,
                                         XML_PARSE_NONET | XML_PARSE_NOERROR | XML_PARSE_NOWARNING));
  if (allowance.has_doctype)
    throw std::runtime_error(source + ": has a document type declaration (DOCTYPE); required: none");
  if (allowance.parts > Allowance::kMostParts)
    throw std::runtime_error(
        fmt::format("{}: has more than {} elements and attributes; required: at most that many", source,
                    Allowance::kMostParts));
  if (document) return document;
  const xmlError* error = xmlGetLastError();
  const std::string why =
      error == nullptr || error->message == nullptr ? "not XML" : one_line(error->message);
  throw std::runtime_error(fmt::format("{}: line {}: {}", source, error == nullptr ? 0 : error->line, why));
}

}  // namespace abcal
