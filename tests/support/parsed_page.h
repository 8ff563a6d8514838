#pragma once

#include <libxml/HTMLparser.h>
#include <libxml/xpath.h>

#include <memory>
#include <string>
#include <vector>

namespace abcal::test {

/// A page as a browser reads it.
class ParsedPage {
 public:
  explicit ParsedPage(const std::string& html)
      : document_(htmlReadMemory(html.data(), static_cast<int>(html.size()), nullptr, "utf-8",
                                 HTML_PARSE_NONET | HTML_PARSE_NOERROR | HTML_PARSE_NOWARNING),
                  xmlFreeDoc) {}

  /// The text or attribute values that an XPath expression finds.
  std::vector<std::string> find(const std::string& path) const {
    std::vector<std::string> found;
    const std::unique_ptr<xmlXPathContext, decltype(&xmlXPathFreeContext)> context(
        xmlXPathNewContext(document_.get()), xmlXPathFreeContext);
    const std::unique_ptr<xmlXPathObject, decltype(&xmlXPathFreeObject)> result(
        xmlXPathEvalExpression(reinterpret_cast<const xmlChar*>(path.c_str()), context.get()),
        xmlXPathFreeObject);
    for (int i = 0; result && result->nodesetval != nullptr && i < result->nodesetval->nodeNr; ++i) {
      const std::unique_ptr<xmlChar, decltype(xmlFree)> text(
          xmlNodeGetContent(result->nodesetval->nodeTab[i]), xmlFree);
      found.emplace_back(reinterpret_cast<const char*>(text.get()));
    }
    return found;
  }

 private:
  std::unique_ptr<xmlDoc, decltype(&xmlFreeDoc)> document_;
};

}  // namespace abcal::test
