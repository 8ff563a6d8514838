#include "app/certificate/sign.h"

#include <fstream>
#include <sstream>
#include <stdexcept>

#include "app/system/helper_program.h"
#include "app/system/temporary_folder.h"

namespace abcal {

std::string sign_xml(const std::string& xml, const SigningKey& with) {
  const TemporaryFolder folder;  // For this user only.
  const std::filesystem::path unsigned_file = folder / "unsigned.xml", signed_file = folder / "signed.xml";
  std::ofstream unsigned_xml(unsigned_file, std::ios::binary);
  unsigned_xml << xml;
  unsigned_xml.close();
  if (!unsigned_xml)
    throw std::runtime_error(unsigned_file.string() + ": cannot be written (is the disk full?)");
  run_helper("abcal-sign", "certificates are signed by",
             {"sign", "--", unsigned_file.string(), with.key.string(), with.certificate.string(),
              signed_file.string()});
  std::ostringstream signed_xml;
  signed_xml << std::ifstream(signed_file, std::ios::binary).rdbuf();
  return signed_xml.str();
}

}  // namespace abcal
