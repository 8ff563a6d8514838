#include "app/formats/xml_query.h"

#include <fmt/format.h>
#include <libxml/xpathInternals.h>

#include <new>
#include <stdexcept>
#include <utility>

#include "drivers/text/text.h"

namespace abcal {
namespace {

constexpr std::size_t kLongestList = 1u << 20;  // Bytes: some 100 000 numbers.

}  // namespace

std::string owned_text(xmlChar* text) {
  if (text == nullptr) return {};
  std::string copy(reinterpret_cast<const char*>(text));
  xmlFree(text);
  return copy;
}

std::string xml_content(const xmlNode* node) {
  return owned_text(xmlNodeGetContent(node));
}

std::vector<std::string> xml_words(std::string_view list) {
  const std::vector<std::string_view> words = pieces::words(list);
  return {words.begin(), words.end()};
}

XmlQuery::XmlQuery(xmlDoc* document) : context_(xmlXPathNewContext(document)) {
  if (!context_) throw std::bad_alloc();
  for (const auto& [prefix, uri] : {std::pair{"dcc", "https://ptb.de/dcc"},
                                    {"si", "https://ptb.de/si"},
                                    {"ds", "http://www.w3.org/2000/09/xmldsig#"},
                                    {"xades", "http://uri.etsi.org/01903/v1.3.2#"}})
    xmlXPathRegisterNs(context_.get(), as_xml(prefix), as_xml(uri));
}

std::vector<xmlNode*> XmlQuery::nodes(const std::string& path, xmlNode* from) const {
  context_->node = from != nullptr ? from : xmlDocGetRootElement(context_->doc);
  const std::unique_ptr<xmlXPathObject, decltype(&xmlXPathFreeObject)> found(
      xmlXPathEvalExpression(as_xml(path.c_str()), context_.get()), xmlXPathFreeObject);
  if (!found) throw std::logic_error("not an XPath: " + path);
  if (found->nodesetval == nullptr) return {};
  return {found->nodesetval->nodeTab, found->nodesetval->nodeTab + found->nodesetval->nodeNr};
}

std::vector<std::string> XmlQuery::texts(const std::string& path, xmlNode* from) const {
  std::vector<std::string> texts;
  for (const xmlNode* node : nodes(path, from)) texts.push_back(xml_content(node));
  return texts;
}

std::string XmlQuery::text(const std::string& path, xmlNode* from) const {
  const std::vector<xmlNode*> found = nodes(path, from);
  return found.empty() ? std::string() : std::string(pieces::trimmed(xml_content(found.front())));
}

std::vector<std::string> XmlQuery::words(const std::string& path, xmlNode* from) const {
  const std::string list = text(path, from);
  if (list.size() > kLongestList)
    throw std::runtime_error(
        fmt::format("{}: a list of {} bytes; required: at most {}", path, list.size(), kLongestList));
  return xml_words(list);
}

}  // namespace abcal
