#include "app/laboratory/certificate/sign.h"

#include <fstream>
#include <sstream>
#include <stdexcept>

#include "app/system/helper_program.h"
#include "app/system/temporary_folder.h"

namespace abcal {

namespace {

void write_for_helper(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream file(path, std::ios::binary);
  file << bytes;
  file.close();
  if (!file) throw std::runtime_error(path.string() + ": cannot be written (is the disk full?)");
}

}  // namespace

std::string sign_xml(const std::string& xml, const SigningKey& with, const std::string& utc) {
  const TemporaryFolder folder;  // For this user only.
  const std::filesystem::path unsigned_file = folder / "unsigned.xml", signed_file = folder / "signed.xml";
  write_for_helper(unsigned_file, xml);
  run_helper("abcal-sign", "certificates are signed by",
             {"sign", "--utc", utc, "--", unsigned_file.string(), with.key.string(),
              with.certificate.string(), signed_file.string()});
  std::ostringstream signed_xml;
  signed_xml << std::ifstream(signed_file, std::ios::binary).rdbuf();
  return signed_xml.str();
}

std::string why_signature_fails(const std::string& xml, const std::string& certificate_pem) {
  const TemporaryFolder folder;
  const std::filesystem::path signed_file = folder / "signed.xml", certificate = folder / "certificate.pem";
  write_for_helper(signed_file, xml);
  write_for_helper(certificate, certificate_pem);
  const ToolResult result = run_tool_for_words(helper_program("abcal-sign", "signatures are checked by"),
                                               {"verify", "--", signed_file.string(), certificate.string()});
  if (result.exit_code == 0) return {};
  return "it does not verify: the certificate was changed after it was signed, or is signed by another key";
}

}  // namespace abcal
