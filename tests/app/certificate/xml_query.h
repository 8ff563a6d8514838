#pragma once

#include <charconv>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/formats/xml_query.h"

namespace abcal {

/// Asks the XML text of a certificate by XPath.
class CertificateXml {
 public:
  explicit CertificateXml(const std::string& xml)
      : document_(parse_xml(xml, "certificate")), query_(document_.get()) {}

  std::vector<std::string> texts(const std::string& path) const { return query_.texts(path); }

  /// The text of the first; empty if there is none.
  std::string text(const std::string& path) const {
    const auto all = texts(path);
    return all.empty() ? std::string() : all.front();
  }

  /// The numbers of the first, which is a list.
  std::vector<double> numbers(const std::string& path) const {
    std::vector<double> numbers;
    for (const std::string& word : query_.words(path)) {
      double number = 0.0;
      if (std::from_chars(word.data(), word.data() + word.size(), number).ptr != word.data() + word.size())
        throw std::runtime_error("not a number: " + word);
      numbers.push_back(number);
    }
    return numbers;
  }

 private:
  XmlDocument document_;
  XmlQuery query_;
};

}  // namespace abcal
