#include "app/laboratory/certificate/series_files.h"

#include <fmt/format.h>

#include "app/formats/xml_query.h"
#include "app/formats/xml_tree.h"
#include "protocol/record/sha256.h"

namespace abcal {

std::vector<IntegrityCheck> check_series_files(const std::vector<IssuedCertificate>& certificates,
                                               const std::filesystem::path& folder) {
  std::vector<IntegrityCheck> checks;
  for (const IssuedCertificate& certificate : certificates) {
    const XmlDocument document = parse_xml(certificate.xml, certificate.number);
    const XmlQuery query(document.get());
    for (xmlNode* point : query.nodes("dcc:measurementResults/dcc:measurementResult[@refType="
                                      "'abc_temperatureSeries']/dcc:measurementMetaData/"
                                      "dcc:metaData[starts-with(@refType, 'abc_seriesPoint')]")) {
      const std::filesystem::path name =
          std::filesystem::path(query.text("dcc:description/dcc:content", point)).filename();
      const std::string required = query.text("dcc:data/dcc:text/dcc:content", point);
      const std::string what =
          fmt::format("certificate {}, point over temperature {}", certificate.number, name.string());
      if (!std::filesystem::is_regular_file(folder / name)) {
        checks.push_back({what, true, "not in the folder of the run; its SHA-256 is " + required});
        continue;
      }
      const std::string found = sha256_of_file(folder / name);
      checks.push_back({what, found == required,
                        found == required ? "SHA-256 as in the certificate"
                                          : fmt::format("SHA-256 {}; required: that of the certificate, {}",
                                                        found, required)});
    }
  }
  return checks;
}

}  // namespace abcal
