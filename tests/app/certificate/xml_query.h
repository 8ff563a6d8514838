#pragma once

#include <libxml/parser.h>
#include <libxml/xpath.h>
#include <libxml/xpathInternals.h>

#include <charconv>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/xml/xml_tree.h"

namespace abcal {

/// Asks an XML text by XPath; the prefixes dcc, si and ds are known.
class XmlQuery {
 public:
  explicit XmlQuery(const std::string& xml)
      : document_(parse_xml(xml, "certificate")), context_(xmlXPathNewContext(document_.get())) {
    for (const auto& [prefix, uri] : {std::pair{"dcc", "https://ptb.de/dcc"},
                                      {"si", "https://ptb.de/si"},
                                      {"ds", "http://www.w3.org/2000/09/xmldsig#"}})
      xmlXPathRegisterNs(context_.get(), reinterpret_cast<const xmlChar*>(prefix),
                         reinterpret_cast<const xmlChar*>(uri));
  }

  std::vector<std::string> texts(const std::string& path) const {
    const std::unique_ptr<xmlXPathObject, decltype(&xmlXPathFreeObject)> found(
        xmlXPathEvalExpression(reinterpret_cast<const xmlChar*>(path.c_str()), context_.get()),
        xmlXPathFreeObject);
    if (!found) throw std::logic_error("not an XPath: " + path);
    std::vector<std::string> texts;
    for (int i = 0; found->nodesetval != nullptr && i < found->nodesetval->nodeNr; ++i) {
      xmlChar* content = xmlNodeGetContent(found->nodesetval->nodeTab[i]);
      texts.emplace_back(reinterpret_cast<const char*>(content));
      xmlFree(content);
    }
    return texts;
  }

  /// The text of the first; empty if there is none.
  std::string text(const std::string& path) const {
    const auto all = texts(path);
    return all.empty() ? std::string() : all.front();
  }

  /// The numbers of the first, which is a list.
  std::vector<double> numbers(const std::string& path) const {
    std::istringstream words(text(path));
    std::vector<double> numbers;
    for (std::string word; words >> word;) {
      double number = 0.0;
      if (std::from_chars(word.data(), word.data() + word.size(), number).ptr != word.data() + word.size())
        throw std::runtime_error("not a number: " + word);
      numbers.push_back(number);
    }
    return numbers;
  }

 private:
  struct Free {
    void operator()(xmlXPathContext* context) const { xmlXPathFreeContext(context); }
  };
  XmlDocument document_;
  std::unique_ptr<xmlXPathContext, Free> context_;
};

}  // namespace abcal
