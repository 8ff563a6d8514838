#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "tests/app/certificate/xml_query.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace abcal {

/// Runs a command of the shell; its exit code and what it wrote.
inline std::pair<int, std::string> shell(const std::string& command, const test::TemporaryFolder& where) {
  const auto log = where / "shell.log";
  const int status = std::system((command + " > " + log.string() + " 2>&1").c_str());
  return {status, test::read_file(log)};
}

inline constexpr const char* kSaxon = "/usr/share/java/Saxon-HE.jar";

/// Whether the programs of schematron_errors() are installed.
inline bool has_schematron_reader(const test::TemporaryFolder& where) {
  return std::filesystem::exists(kSaxon) && shell("command -v java", where).first == 0;
}

/// The errors and warnings of the Schematron of the PTB for a certificate.
/// @param rules  its compiled form
inline std::vector<std::string> schematron_errors(const std::string& xml, const std::filesystem::path& rules,
                                                  const test::TemporaryFolder& where) {
  test::write_file(where / "a.xml", xml);
  const auto [code, said] =
      shell(std::string("java -cp ") + kSaxon + " net.sf.saxon.Transform -s:'" + (where / "a.xml").string() +
                "' -xsl:'" + rules.string() + "' -o:'" + (where / "out.xml").string() + "'",
            where);
  EXPECT_EQ(code, 0) << said;
  return CertificateXml(test::read_file(where / "out.xml")).texts("//*[@role='error' or @role='warning']");
}

}  // namespace abcal
