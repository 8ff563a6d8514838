#include "app/laboratory/certificate/schema_check.h"

#include <fmt/format.h>
#include <libxml/parser.h>
#include <libxml/xmlIO.h>
#include <libxml/xmlschemas.h>

#include <stdexcept>

#include "app/system/helper_program.h"

namespace abcal {
namespace {

/// Keeps libxml2 off the network while a schema is read; the loader is global to libxml2.
class NoNetwork {
 public:
  NoNetwork() : before_(xmlGetExternalEntityLoader()) {
    xmlSetExternalEntityLoader(xmlNoNetExternalEntityLoader);
  }
  NoNetwork(const NoNetwork&) = delete;
  NoNetwork& operator=(const NoNetwork&) = delete;
  ~NoNetwork() { xmlSetExternalEntityLoader(before_); }

 private:
  xmlExternalEntityLoader before_;
};

void collect(void* into, xmlError* error) {
  auto& problems = *static_cast<std::vector<DccProblem>*>(into);
  problems.push_back({error->line > 0 ? fmt::format("line {}", error->line) : "the certificate",
                      error->message == nullptr ? "not valid" : one_line(error->message)});
}

std::filesystem::path schema_file(const std::filesystem::path& folder) {
  for (const char* at : {"v3.3.0/dcc.xsd", "xsd/v3.3.0/dcc.xsd", "dcc.xsd"}) {
    std::error_code error;
    if (std::filesystem::is_regular_file(folder / at, error)) return folder / at;
  }
  throw std::invalid_argument(fmt::format(
      "--schemas {}: no schema of the certificate there; required: a folder with v3.3.0/dcc.xsd and "
      "what it imports (D-SI 2.2.1, XML-DSig)",
      folder.string()));
}

}  // namespace

struct DccSchema::Impl {
  std::unique_ptr<xmlSchema, decltype(&xmlSchemaFree)> schema{nullptr, xmlSchemaFree};
};

DccSchema::DccSchema(const std::filesystem::path& folder) : impl_(std::make_unique<Impl>()) {
  const NoNetwork offline;
  const std::filesystem::path file = schema_file(folder);
  std::vector<DccProblem> problems;
  const std::unique_ptr<xmlSchemaParserCtxt, decltype(&xmlSchemaFreeParserCtxt)> parser(
      xmlSchemaNewParserCtxt(file.c_str()), xmlSchemaFreeParserCtxt);
  xmlSchemaSetParserStructuredErrors(parser.get(), collect, &problems);
  impl_->schema.reset(xmlSchemaParse(parser.get()));
  if (!impl_->schema)
    throw std::invalid_argument(
        fmt::format("{}: the schema cannot be used{}", file.string(), to_string(problems)));
}

DccSchema::DccSchema(DccSchema&&) noexcept = default;
DccSchema& DccSchema::operator=(DccSchema&&) noexcept = default;
DccSchema::~DccSchema() = default;

std::vector<DccProblem> DccSchema::check(const XmlDocument& document) const {
  std::vector<DccProblem> problems;
  const std::unique_ptr<xmlSchemaValidCtxt, decltype(&xmlSchemaFreeValidCtxt)> validation(
      xmlSchemaNewValidCtxt(impl_->schema.get()), xmlSchemaFreeValidCtxt);
  xmlSchemaSetValidStructuredErrors(validation.get(), collect, &problems);
  if (xmlSchemaValidateDoc(validation.get(), document.get()) != 0 && problems.empty())
    problems.push_back({"the certificate", "could not be validated"});
  return problems;
}

std::filesystem::path program_schemas() {
  return program_data("schemas");
}

}  // namespace abcal
