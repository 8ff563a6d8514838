// Certificates that do not hold any more when a comparison is analysed.

#include "app/laboratory/pilot/pilot_analysis.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "app/system/output_file.h"
#include "protocol/record/sha256.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

/// Three laboratories whose results are tables that name their certificates, CERT-1 to CERT-3.
class ThreeCertificates : public testing::Test {
 protected:
  ThreeCertificates() {
    std::string text =
        "[comparison]\nname = \"three\"\npilot = \"LAB1\"\nitem_serial_number = \"17\"\nresponse_unit = "
        "\"V\"\n"
        "procedure = \"A\"\ndraws = 1000\n";
    for (const char* number : {"1", "2", "3"})
      text += std::string("[[participant]]\nname = \"LAB") + number + "\"\n";
    for (const char* number : {"1", "2", "3"})
      text += std::string("[[measurement]]\nparticipant = \"LAB") + number + "\"\n";
    OutputFile(folder_ / "c.toml").write(text);
    const ComparisonProtocol read = protocol();
    ComparisonChain chain(read);
    for (const char* number : {"1", "2", "3"}) {
      const auto file = folder_ / (std::string(number) + ".csv");
      OutputFile(file).write(table(number));
      chain.add_result(std::string("LAB") + number, sha256_of_file(file), file, Clock::UtcTime());
    }
  }
  ComparisonProtocol protocol() const { return read_comparison_protocol(folder_ / "c.toml"); }
  PilotAnalysis analysed(const CertificateDoubt& doubt) const {
    const ComparisonProtocol read = protocol();
    return analyse_comparison(read, ComparisonChain(read), doubt);
  }
  static std::string table(const std::string& number) {
    std::string text = "# response_unit: V\n# item_serial_number: 17\n# certificate: CERT-" + number +
                       "\n# stage: " + number +
                       "\nquantity,value,s_u,s_v,s_w,phi_uv,phi_vw,phi_wu,O_u,O_v,O_w\n";
    for (std::size_t i = 0; i < 9; ++i) {
      text += std::string(kIntrinsicSymbols[i]) + ",0.1";
      for (std::size_t k = 0; k < 9; ++k) text += i == k ? ",1e-10" : ",0";
      text += "\n";
    }
    return text;
  }

  test::TemporaryFolder folder_;
};

TEST_F(ThreeCertificates, AreUsedWhileTheyHold) {
  EXPECT_EQ(analysed({}).participants.size(), 3U) << "without a register";
  EXPECT_EQ(analysed([](const std::string&) { return std::string(); }).participants.size(), 3U);
}

TEST_F(ThreeCertificates, TheWithdrawnOneIsNamedWithTheReason) {
  const CertificateDoubt doubt = [](const std::string& number) {
    return number == "CERT-2" ? std::string("was withdrawn on 2026-05-04 (wrong range)") : std::string();
  };
  try {
    (void)analysed(doubt);
    FAIL() << "a withdrawn certificate must not count silently";
  } catch (const KeyComparisonError& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("measurement 2 by LAB2"), HasSubstr("CERT-2 was withdrawn"),
                                    HasSubstr("wrong range"), HasSubstr("required: --withdraw REASON")));
  }
}

}  // namespace
}  // namespace abcal
