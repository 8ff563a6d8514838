#pragma once

#include <libxml/tree.h>
#include <libxml/xpath.h>

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "app/formats/xml_tree.h"

namespace abcal {

/// Copies and frees a text that libxml2 allocated; empty for a null pointer.
std::string owned_text(xmlChar* text);

/// The text below a node, unchanged.
std::string xml_content(const xmlNode* node);

/// The words of a list, separated by white space.
std::vector<std::string> xml_words(std::string_view list);

/// Asks a document by XPath. The prefixes dcc, si, ds (XML signature) and xades are known. Paths start at the
/// root element unless `from` is given. @throws std::logic_error for a text that is not XPath
class XmlQuery {
 public:
  /// @param document  must outlive the query
  explicit XmlQuery(xmlDoc* document);

  std::vector<xmlNode*> nodes(const std::string& path, xmlNode* from = nullptr) const;
  bool any(const std::string& path, xmlNode* from = nullptr) const { return !nodes(path, from).empty(); }
  /// Text of each node, unchanged.
  std::vector<std::string> texts(const std::string& path, xmlNode* from = nullptr) const;
  /// Text of the first node, without white space at its ends; empty if no node is found.
  std::string text(const std::string& path, xmlNode* from = nullptr) const;
  /// Words of the first node, which is a list. @throws std::runtime_error for a list of more than 1 MiB
  std::vector<std::string> words(const std::string& path, xmlNode* from = nullptr) const;

 private:
  struct FreeContext {
    void operator()(xmlXPathContext* context) const { xmlXPathFreeContext(context); }
  };
  std::unique_ptr<xmlXPathContext, FreeContext> context_;
};

}  // namespace abcal
