#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/business_rules.h"

namespace abcal {

/// The XML schemas of the digital calibration certificate, read once. Nothing is loaded from the network.
class DccSchema {
 public:
  /// @param folder  contains v3.3.0/dcc.xsd, directly or in xsd/, and the schemas that it imports
  /// @throws std::invalid_argument  if it is missing or cannot be read, with libxml2's message
  explicit DccSchema(const std::filesystem::path& folder);
  DccSchema(DccSchema&&) noexcept;
  DccSchema& operator=(DccSchema&&) noexcept;
  ~DccSchema();

  /// Every violation, with its line.
  std::vector<DccProblem> check(const XmlDocument& document) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// The folder of the schemas that come with the program: in its own folder, or installed in
/// ../share/abcal/schemas.
std::filesystem::path program_schemas();

}  // namespace abcal
