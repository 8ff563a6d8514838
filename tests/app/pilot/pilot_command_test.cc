// A comparison as its pilot runs it: from the protocol to the draft report, and everything that can be wrong.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "protocol/quantities/output_names.h"
#include "protocol/record/sha256.h"
#include "tests/app/program_fixtures.h"
#include "tests/app/readings_csv.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

constexpr std::array<double, 9> kTruth{0.1, 0.11, 0.12, 89.9, 90.2, 90.05, 0.01, -0.02, 0.03};
constexpr std::array<double, 9> kU{2e-6, 2e-6, 2e-6, 1e-3, 1e-3, 1e-3, 5e-6, 5e-6, 5e-6};

class PilotCommand : public ProgramTest {
 protected:
  PilotCommand() { write_protocol(""); }

  /// Four laboratories, LAB1 first, in the middle and at the end.
  void write_protocol(const std::string& more, const std::string& of_lab4 = "") {
    std::string text =
        "[comparison]\nname = \"Comparison of four\"\npilot = \"LAB1\"\nitem_serial_number = \"17\"\n"
        "response_unit = \"V\"\ndrift = \"line per transfer\"\n"
        "repeatability = [6e-7, 6e-7, 6e-7, 3e-4, 3e-4, 3e-4, 1.5e-6, 1.5e-6, 1.5e-6]\ndraws = 5000\n";
    text += more;
    for (const char* name : {"LAB1", "LAB2", "LAB3", "LAB4"})
      text += std::string("[[participant]]\nname = \"") + name + "\"\n" + (name[3] == '4' ? of_lab4 : "");
    for (const char* name : {"LAB1", "LAB2", "LAB1", "LAB3", "LAB4", "LAB1"})
      text += std::string("[[measurement]]\nparticipant = \"") + name + "\"\ndate = 2026-02-02\n";
    test::write_file(folder / "c.toml", text);
  }

  /// Puts other words in the protocol.
  void change_protocol(const std::string& from, const std::string& to) {
    std::string text = test::read_file(folder / "c.toml");
    const std::size_t at = text.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    test::write_file(folder / "c.toml", text.replace(at, from.size(), to));
  }

  struct Made {
    std::array<double, 9> values = kTruth;
    std::string unit = "V", serial_number = "17";
    double scale = 1.0;
    bool last_quantity = true;
    double error = 0.3;  ///< Size of the drawn errors in standard uncertainties.
  };
  /// A table with covariance; errors are drawn.
  void write_table(const std::string& name, const Made& made, unsigned seed) {
    std::mt19937_64 engine(seed);
    std::normal_distribution<double> normal;
    std::string text = "# response_unit: " + made.unit + "\n# item_serial_number: " + made.serial_number +
                       "\nquantity,value,s_u,s_v,s_w,phi_uv,phi_vw,phi_wu,O_u,O_v,O_w\n";
    for (std::size_t i = 0; i < (made.last_quantity ? 9U : 8U); ++i) {
      const auto scaled = [&](std::size_t k) { return k < 3 || k > 5 ? made.scale : 1.0; };
      text += std::string(kIntrinsicSymbols[i]) + "," +
              number((made.values[i] + made.error * kU[i] * normal(engine)) * scaled(i));
      for (std::size_t k = 0; k < 9; ++k)
        text += "," + number((i == k ? 1.0 : 0.2) * kU[i] * kU[k] * scaled(i) * scaled(k));
      text += "\n";
    }
    test::write_file(folder / name, text);
  }
  static std::string number(double value) {
    std::ostringstream text;
    text.precision(15);
    text << value;
    return text.str();
  }

  ProgramResult pilot(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "pilot");
    return abcal(arguments);
  }
  ProgramResult add(const std::string& participant, const std::string& file) {
    return pilot({"add", "c.toml", file, "--participant", participant});
  }
  /// Adds all six results; those of `made` in place of good ones, by number from 1.
  void add_all(const std::map<int, Made>& made = {}) {
    int number_of = 0;
    for (const char* name : {"LAB1", "LAB2", "LAB1", "LAB3", "LAB4", "LAB1"}) {
      ++number_of;
      const std::string file = std::to_string(number_of) + ".csv";
      const auto found = made.find(number_of);
      write_table(file, found == made.end() ? Made() : found->second, static_cast<unsigned>(number_of));
      const ProgramResult added = add(name, file);
      ASSERT_EQ(added.exit_code, 0) << added.err;
    }
  }
  Json analysis(int exit_code) {
    const ProgramResult result = pilot({"analyse", "c.toml", "--json"});
    EXPECT_EQ(result.exit_code, exit_code) << result.err;
    return Json::parse(result.out);
  }
};

TEST_F(PilotCommand, FromProtocolToReport) {
  ASSERT_EQ(pilot({"init", "example.toml"}).exit_code, 0);
  EXPECT_EQ(pilot({"status", "example.toml"}).exit_code, 0) << "the example is a protocol";
  EXPECT_NE(pilot({"init", "example.toml"}).exit_code, 0) << "never in place of a file";
  add_all();
  const ProgramResult status = pilot({"status", "c.toml"});
  EXPECT_THAT(status.out, AllOf(HasSubstr("6 of 6"), HasSubstr("in since")));
  ASSERT_EQ(
      pilot({"add", "c.toml", "--participant", "LAB3", "--statement", "A new polygon since."}).exit_code, 0);
  const Json json = analysis(0);
  EXPECT_EQ(json["schema"], "abcal.pilot/1");
  EXPECT_EQ(json["reference"]["procedure"], "A");
  EXPECT_EQ(json["participants"].size(), 4U);
  EXPECT_EQ(json["participants"][0]["pairs"].size(), 3U);
  EXPECT_EQ(json["statements"][0]["text"], "A new polygon since.");
  EXPECT_EQ(json["units"][0], "V/(m/s2)");
  for (std::size_t q = 0; q < 9; ++q) {
    const double u = std::sqrt(json["reference"]["covariance"][q][q].get<double>());
    EXPECT_NEAR(json["reference"]["values"][q].get<double>(), kTruth[q], 3.0 * u);
    EXPECT_LT(u, kU[q]);
  }
  const ProgramResult text = pilot({"analyse", "c.toml"});
  EXPECT_THAT(text.out, AllOf(HasSubstr("Draft A"), HasSubstr("The participants agree"), HasSubstr("phi_vw"),
                              HasSubstr("A new polygon since.")));
  ASSERT_EQ(pilot({"report", "c.toml", "--html", "a.html", "--pdf", "a.pdf"}).exit_code, 0);
  EXPECT_THAT(test::read_file(folder / "a.html"), AllOf(HasSubstr("<svg"), HasSubstr("LAB4")));
  EXPECT_THAT(test::read_file(folder / "a.pdf").substr(0, 5), "%PDF-");
  EXPECT_EQ(pilot({"report", "c.toml", "--html", "a.html"}).exit_code, 2) << "exists";
}

TEST_F(PilotCommand, DraftBNeedsTheAgreementOfAllAndHasACertificate) {
  write_table("1.csv", {}, 1);
  EXPECT_THAT(pilot({"add", "c.toml", "--participant", "LAB2", "--agree"}).err,
              HasSubstr("no Draft A to agree with"));
  add_all();
  const ProgramResult early = pilot({"report", "c.toml", "--draft", "B", "--pdf", "b.pdf"});
  EXPECT_EQ(early.exit_code, 2);
  EXPECT_THAT(early.err, AllOf(HasSubstr("agreement of all participants"),
                               HasSubstr("missing: LAB1, LAB2, LAB3, LAB4"), HasSubstr("--agree")));
  for (const char* name : {"LAB1", "LAB2", "LAB3", "LAB4"})
    ASSERT_EQ(pilot({"add", "c.toml", "--participant", name, "--agree"}).exit_code, 0);
  EXPECT_THAT(pilot({"add", "c.toml", "--participant", "LAB2", "--agree"}).err,
              HasSubstr("has agreed already"));
  EXPECT_THAT(pilot({"status", "c.toml"}).out, HasSubstr("All participants agree."));
  // A statement voids nothing.
  ASSERT_EQ(
      pilot({"add", "c.toml", "--participant", "LAB3", "--statement", "A new polygon since."}).exit_code, 0);
  const ProgramResult text = pilot({"report", "c.toml", "--draft", "B"});
  EXPECT_EQ(text.exit_code, 0) << text.err;
  EXPECT_THAT(text.out,
              AllOf(HasSubstr("Draft B: Comparison of four"), HasSubstr("All participants agreed")));
  ASSERT_EQ(pilot({"report", "c.toml", "--draft", "B", "--pdf", "b.pdf"}).exit_code, 0);
  EXPECT_EQ(test::read_file(folder / "b.pdf").substr(0, 5), "%PDF-");

  const std::string laboratory = (test::source_folder() / "docs/examples/laboratory.toml").string();
  const auto certificate = [&](const std::string& draft, const std::string& approver) {
    return pilot({"report", "c.toml", "--draft", draft, "--xml", "b.xml", "--laboratory", laboratory,
                  "--number", "CMP-1", "--approved-by", approver});
  };
  EXPECT_THAT(certificate("A", "Approver N. N.").err, HasSubstr("required: --draft B"));
  EXPECT_THAT(certificate("B", "Operator N. N.").err, HasSubstr("who may approve"));
  EXPECT_FALSE(std::filesystem::exists(folder / "b.xml")) << "nothing is written then";
  const ProgramResult written = certificate("B", "Approver N. N.");
  ASSERT_EQ(written.exit_code, 0) << written.err;
  // The schema and the business rules were checked before it was written.
  EXPECT_THAT(
      test::read_file(folder / "b.xml"),
      AllOf(HasSubstr("comparison_referenceValue"), HasSubstr("comparison_equivalenceValueEnCriterion"),
            HasSubstr("LAB1-LAB2"), HasSubstr("CMP-1"), HasSubstr("A new polygon since.")));

  // A late change voids all agreements.
  write_table("again.csv", {}, 50);
  ASSERT_EQ(
      pilot({"add", "c.toml", "again.csv", "--participant", "LAB3", "--replace", "wrong gain"}).exit_code, 0);
  EXPECT_THAT(pilot({"report", "c.toml", "--draft", "B"}).err, HasSubstr("missing: LAB1, LAB2, LAB3, LAB4"));
}

TEST_F(PilotCommand, CompareSaysTheSameNumbers) {
  // Each of three measured once; one quantity alone, because compare has one variance between for each.
  test::write_file(folder / "c.toml",
                   "[comparison]\nname = \"three\"\npilot = \"LAB1\"\nitem_serial_number = \"17\"\n"
                   "response_unit = \"V\"\nprocedure = \"A\"\ndraws = 5000\n"
                   "[[participant]]\nname = \"LAB1\"\n[[participant]]\nname = \"LAB2\"\n"
                   "[[participant]]\nname = \"LAB3\"\n[[measurement]]\nparticipant = \"LAB1\"\n"
                   "[[measurement]]\nparticipant = \"LAB2\"\n[[measurement]]\nparticipant = \"LAB3\"\n");
  const std::vector<std::string> files{"1.csv", "2.csv", "3.csv"};
  for (unsigned k = 0; k < 3; ++k) {
    write_table(files[k], {.error = 1.0}, 70 + k);
    ASSERT_EQ(add("LAB" + std::to_string(k + 1), files[k]).exit_code, 0);
  }
  const Json pilots = Json::parse(pilot({"analyse", "c.toml", "--json"}).out);
  const ProgramResult compared = abcal({"compare", "1.csv", "2.csv", "3.csv", "--json"});
  const Json json = Json::parse(compared.out);
  const auto same = [](const Json& a, const Json& b, const std::string& what) {
    EXPECT_NEAR(a.get<double>(), b.get<double>(), 1e-9 * std::abs(b.get<double>())) << what;
  };
  same(json["several"]["consistency"]["all"]["chi2"], pilots["consistency"]["all_quantities"]["chi2"],
       "chi2");
  same(json["several"]["consistency"]["all"]["chi2_probability"],
       pilots["consistency"]["all_quantities"]["chi2_probability"], "probability");
  ASSERT_TRUE(json["several"]["consistency"]["agree"]);
  for (std::size_t k = 0; k < 2; ++k) {
    const Json& pair = json["pairs"][k];
    const Json& here = pilots["participants"][0]["pairs"][k];
    for (std::size_t q = 0; q < 9; ++q) {
      const Json& property = pair["properties"][std::string(kIntrinsicSymbols[q])];
      // compare has second minus first.
      EXPECT_NEAR(property["difference"].get<double>(), -here["differences"][q].get<double>(), 1e-15);
      same(property["standard_uncertainty"], std::sqrt(here["covariance"][q][q].get<double>()),
           std::string(kIntrinsicSymbols[q]));
      same(property["e_n"],
           -here["differences"][q].get<double>() / here["expanded_uncertainties"][q].get<double>(), "E_n");
    }
  }
  // Where the uncertainties explain all, the mean of random effects of a quantity is that of procedure A of
  // it.
  test::write_file(folder / "c.toml.chain", "");
  std::string one = test::read_file(folder / "c.toml");
  one.insert(one.find("procedure"), "quantities = [\"s_v\"]\n");
  test::write_file(folder / "c.toml", one);
  for (unsigned k = 0; k < 3; ++k) ASSERT_EQ(add("LAB" + std::to_string(k + 1), files[k]).exit_code, 0);
  const Json alone = Json::parse(pilot({"analyse", "c.toml", "--json"}).out);
  Json random;
  for (const Json& other : alone["other_procedures"])
    if (other["procedure"] == "random-effects") random = other;
  const Json& mean = json["several"]["properties"]["s_v"]["random_effects"];
  same(mean["mean"], random["values"][0], "mean");
  same(mean["standard_uncertainty"], std::sqrt(random["covariance"][0][0].get<double>()), "u of the mean");
  EXPECT_NEAR(mean["between"].get<double>(), random["between"][0].get<double>(), 1e-12);
}

TEST_F(PilotCommand, ResultsThatAreAddedAtOnceAreAllIn) {
  const std::vector<std::string> names{"LAB1", "LAB2", "LAB1", "LAB3", "LAB4", "LAB1"};
  std::vector<std::unique_ptr<test::Program>> adding;
  for (std::size_t k = 0; k < names.size(); ++k) {
    const std::string file = std::to_string(k + 1) + ".csv";
    write_table(file, Made(), static_cast<unsigned>(k + 1));
    adding.push_back(std::make_unique<test::Program>(
        std::vector<std::string>{"pilot", "add", "c.toml", file, "--participant", names[k]}, folder.path()));
  }
  for (const auto& each : adding) EXPECT_EQ(each->wait(), 0) << each->err();
  EXPECT_THAT(pilot({"status", "c.toml"}).out, HasSubstr("6 of 6"));
}

TEST_F(PilotCommand, ValuesAreShownWhenAllAreCommitted) {
  write_table("1.csv", {}, 1);
  ASSERT_EQ(add("LAB1", "1.csv").exit_code, 0);
  const ProgramResult early = pilot({"analyse", "c.toml"});
  EXPECT_EQ(early.exit_code, 2);
  EXPECT_THAT(early.err,
              AllOf(HasSubstr("no value is shown before all results are in"),
                    HasSubstr("measurement 2 by LAB2: no result is committed"), Not(HasSubstr("0.1"))));
  // LAB2 commits by its hash, and opens later.
  write_table("2.csv", {}, 2);
  const std::string hash = sha256_of_file(folder / "2.csv");
  ASSERT_EQ(pilot({"add", "c.toml", "--participant", "LAB2", "--sha256", hash}).exit_code, 0);
  EXPECT_THAT(pilot({"status", "c.toml"}).out, HasSubstr("file missing"));
  write_table("other.csv", {}, 3);
  const ProgramResult another = add("LAB2", "other.csv");
  EXPECT_EQ(another.exit_code, 2);
  EXPECT_THAT(another.err, HasSubstr("another SHA-256 than the one that was committed"));
  EXPECT_EQ(add("LAB2", "2.csv").exit_code, 0);
}

TEST_F(PilotCommand, EachResultCountsOnceAndLateChangesAreStated) {
  add_all();
  write_table("again.csv", {}, 50);
  const ProgramResult second = add("LAB3", "again.csv");
  EXPECT_EQ(second.exit_code, 2);
  EXPECT_THAT(second.err,
              AllOf(HasSubstr("LAB3"), HasSubstr("each counts once"), HasSubstr("--replace REASON")));
  EXPECT_THAT(add("LAB4", "2.csv").err, HasSubstr("that of measurement 2 by LAB2 already"));
  ASSERT_EQ(
      pilot({"add", "c.toml", "again.csv", "--participant", "LAB3", "--replace", "wrong gain"}).exit_code, 0);
  EXPECT_THAT(analysis(0)["notes"].dump(), AllOf(HasSubstr("LAB3 replaced its result"),
                                                 HasSubstr("wrong gain"), HasSubstr("6 of 6 results")));
  // A file that is changed afterwards.
  write_table("2.csv", {}, 51);
  const ProgramResult changed = pilot({"analyse", "c.toml"});
  EXPECT_EQ(changed.exit_code, 2);
  EXPECT_THAT(changed.err, HasSubstr("was changed after it was committed"));
}

TEST_F(PilotCommand, WithdrawnResultIsStatedAndThreeMustRemain) {
  add_all();
  ASSERT_EQ(
      pilot({"add", "c.toml", "--participant", "LAB2", "--withdraw", "certificate withdrawn"}).exit_code, 0);
  const Json json = analysis(0);
  EXPECT_EQ(json["participants"].size(), 3U);
  EXPECT_THAT(json["notes"].dump(),
              AllOf(HasSubstr("measurement 2 by LAB2 was withdrawn"), HasSubstr("LAB2 does not take part")));
  ASSERT_EQ(pilot({"add", "c.toml", "--participant", "LAB3", "--withdraw", "same"}).exit_code, 0);
  const ProgramResult two = pilot({"analyse", "c.toml"});
  EXPECT_EQ(two.exit_code, 2);
  EXPECT_THAT(two.err, AllOf(HasSubstr("2 participants have a result"), HasSubstr("three or more")));
}

TEST_F(PilotCommand, ResultsThatCannotBeComparedAreRefusedWithTheReason) {
  const auto refusal = [&](const Made& made) {
    write_table("bad.csv", made, 9);
    const ProgramResult added = add("LAB2", "bad.csv");
    EXPECT_EQ(added.exit_code, 2);
    return added.err;
  };
  EXPECT_THAT(refusal({.unit = "LSB"}), AllOf(HasSubstr("LSB"), HasSubstr("units of one kind")));
  EXPECT_THAT(refusal({.serial_number = "18"}), HasSubstr("required: 17, the artefact"));
  EXPECT_THAT(refusal({.last_quantity = false}), HasSubstr("does not give O_w with an uncertainty"));
  test::write_file(
      folder / "bad.xml",
      "<dcc:digitalCalibrationCertificate xmlns:dcc=\"https://ptb.de/dcc\" "
      "xmlns:si=\"https://ptb.de/si\"><dcc:measurementResults><dcc:measurementResult><dcc:results>"
      "<si:realListXMLList><si:labelXMLList>s_u</si:labelXMLList><si:valueXMLList>0.1"
      "</si:valueXMLList><si:unitXMLList>\\volt\\metre\\tothe{-1}\\second\\tothe{2}</si:unitXMLList>"
      "<si:measurementUncertaintyUnivariateXMLList><si:expandedMUXMLList><si:valueExpandedMUXMLList>1e-5"
      "</si:valueExpandedMUXMLList><si:coverageFactorXMLList>2</si:coverageFactorXMLList>"
      "</si:expandedMUXMLList></si:measurementUncertaintyUnivariateXMLList></si:realListXMLList>"
      "</dcc:results></dcc:measurementResult></dcc:measurementResults>"
      "</dcc:digitalCalibrationCertificate>");
  EXPECT_THAT(add("LAB2", "bad.xml").err, AllOf(HasSubstr("covariance of its quantities"),
                                                HasSubstr("correlations = \"taken as zero\"")));
  // Readings without a local gravity give sensitivities per g_loc only.
  test::write_file(folder / "readings.csv", test::readings(test::kMatrix, 1));
  EXPECT_THAT(add("LAB2", "readings.csv").err,
              AllOf(HasSubstr("readings.csv is no result of this comparison"),
                    HasSubstr("local gravity is not known"), HasSubstr("required: a run file")));
  EXPECT_THAT(add("LAB9", "bad.csv").err, HasSubstr("LAB9 is no participant of c.toml"));
  EXPECT_THAT(pilot({"status", "c.toml"}).out, HasSubstr("0 of 6")) << "nothing was recorded";
}

TEST_F(PilotCommand, OtherUnitsOfOneKindAreConverted) {
  add_all({{4, {.unit = "mV", .scale = 1000.0}}});
  const Json json = analysis(0);
  EXPECT_THAT(json["notes"].dump(), HasSubstr("given in mV, here in V"));
  EXPECT_NEAR(json["participants"][2]["values"][0].get<double>(), kTruth[0], 1e-5);
}

TEST_F(PilotCommand, AxisOfTheOtherSignIsNamed) {
  Made reversed;
  reversed.values[3] = 180.0 - kTruth[3];
  reversed.values[5] = 180.0 - kTruth[5];
  add_all({{5, reversed}});
  const ProgramResult result = pilot({"analyse", "c.toml"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, AllOf(HasSubstr("measurement 5 by LAB4"), HasSubstr("an axis has the other sign")));
}

TEST_F(PilotCommand, BrokenArtefactIsNamedBetweenItsTransfers) {
  Made after;
  after.values[4] += 0.02;
  add_all({{4, after}, {5, after}, {6, after}});
  const ProgramResult result = pilot({"analyse", "c.toml"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.out, AllOf(HasSubstr("The artefact changed between the pilot's measurements 3 and 6"),
                                HasSubstr("phi_vw")));
  EXPECT_EQ(analysis(1)["artefact"]["step"]["between"], Json::array({3, 6}));
}

TEST_F(PilotCommand, DriftIsALineOrAWalk) {
  change_protocol("line per transfer", "line or walk per transfer");
  add_all();
  const Json artefact = analysis(0)["artefact"];
  ASSERT_EQ(artefact["walk_probability"].size(), 9U);
  for (const Json& probability : artefact["walk_probability"]) {
    EXPECT_GT(probability.get<double>(), 0.1);
    EXPECT_LT(probability.get<double>(), 0.9) << "three repeats that agree show neither";
  }
  EXPECT_FALSE(artefact["line"].is_null());
  EXPECT_THAT(pilot({"analyse", "c.toml"}).out,
              AllOf(HasSubstr("lines and random walks, averaged"), HasSubstr("probability of a walk")));
}

TEST_F(PilotCommand, DriftOfTwoMeasurementsIsALineAndTheReportSaysSo) {
  change_protocol("line per transfer", "line or walk per day");
  change_protocol(
      "[[measurement]]\nparticipant = \"LAB1\"\ndate = 2026-02-02\n[[measurement]]\nparticipant = "
      "\"LAB3\"\ndate = 2026-02-02\n",
      "[[measurement]]\nparticipant = \"LAB3\"\ndate = 2026-03-02\n");
  change_protocol("\"LAB4\"\ndate = 2026-02-02\n[[measurement]]\nparticipant = \"LAB1\"\ndate = 2026-02-02",
                  "\"LAB4\"\ndate = 2026-04-02\n[[measurement]]\nparticipant = \"LAB1\"\ndate = 2026-06-02");
  int number_of = 0;
  for (const char* name : {"LAB1", "LAB2", "LAB3", "LAB4", "LAB1"}) {
    const std::string file = std::to_string(++number_of) + ".csv";
    write_table(file, Made(), static_cast<unsigned>(number_of));
    ASSERT_EQ(add(name, file).exit_code, 0);
  }
  const Json json = analysis(0);
  EXPECT_EQ(json["artefact"]["walk_probability"], Json::array());
  EXPECT_THAT(json["notes"].dump(), HasSubstr("two results cannot show a walk"));
}

TEST_F(PilotCommand, BoundOfCorrelationGivesTwoOutcomes) {
  write_protocol("", R"([[correlation_bound]]
name = "gravity network"
participants = ["LAB3", "LAB4"]
correlation = 0.5
quantities = ["s_u", "s_v", "s_w"]
)");
  // LAB4 differs from LAB3 by 2.5 u in s_u: less than 2 sqrt(2) u, and more than 2 u with the correlation.
  Made exact{.error = 1e-3}, off = exact;
  off.values[0] += 2.5 * kU[0];
  add_all({{1, exact}, {2, exact}, {3, exact}, {4, exact}, {5, off}, {6, exact}});
  EXPECT_THAT(
      pilot({"status", "c.toml"}).out,
      HasSubstr("gravity network: the correlation of LAB3, LAB4 in s_u s_v s_w lies between 0 and 0.5."));
  const Json json = analysis(0);
  const Json& bounds = json["correlation_bounds"];
  EXPECT_TRUE(bounds["agree"]);
  EXPECT_THAT(bounds["statements"].dump(),
              AllOf(HasSubstr("LAB3 minus LAB4, s_u: without correlation -"), HasSubstr("does not agree"),
                    Not(HasSubstr("s_v:")), Not(HasSubstr("No statement"))));
  // The pair's U without and with the correlation; the drift adds the same to both.
  const double without = json["participants"][2]["pairs"][2]["expanded_uncertainties"][0];
  EXPECT_GT(without, 5e-6);
  EXPECT_NE(bounds["reference"]["values"], json["reference"]["values"]);
  EXPECT_THAT(pilot({"analyse", "c.toml"}).out,
              AllOf(HasSubstr("Bounds of correlation"), HasSubstr("LAB3 minus LAB4")));
}

TEST_F(PilotCommand, BoundOfCorrelationThatChangesNothingIsSaid) {
  write_protocol("",
                 "[[correlation_bound]]\nname = \"polygon\"\nparticipants = [\"LAB2\", \"LAB3\", \"LAB4\"]\n"
                 "correlation = 0.3\n");
  add_all();
  EXPECT_THAT(analysis(0)["correlation_bounds"]["statements"].dump(),
              HasSubstr("No statement on agreement differs between correlation 0 and the bounds."));
}

TEST_F(PilotCommand, BoundOfCorrelationThatIsImpossibleIsRefused) {
  const auto refusal = [&](const std::string& participants, const std::string& correlation) {
    write_protocol("", "[[correlation_bound]]\nname = \"polygon\"\nparticipants = [" + participants +
                           "]\ncorrelation = " + correlation + "\n");
    return pilot({"status", "c.toml"}).err;
  };
  EXPECT_THAT(refusal("\"LAB2\", \"LAB3\"", "1.5"), AllOf(HasSubstr("correlation_bound"), HasSubstr("1.5")));
  EXPECT_THAT(refusal("\"LAB2\", \"LAB9\"", "0.5"), AllOf(HasSubstr("LAB9"), HasSubstr("[[participant]]")));
  EXPECT_THAT(refusal("\"LAB2\", \"LAB2\"", "0.5"), HasSubstr("two participants or more"));
  EXPECT_THAT(refusal("\"LAB2\", \"LAB3\"", "0"), HasSubstr("the largest correlation that is possible"));
  // Negative correlations of three are possible to -1/2 only.
  EXPECT_THAT(
      refusal("\"LAB2\", \"LAB3\", \"LAB4\"", "-0.6"),
      AllOf(HasSubstr("-0.6"), HasSubstr("above -0.5, the least that 3 results can have, and below 1")));
  EXPECT_EQ(refusal("\"LAB2\", \"LAB3\", \"LAB4\"", "-0.4"), "");
  EXPECT_THAT(refusal("\"LAB2\", \"LAB3\"", "1"), HasSubstr("below 1"));
  EXPECT_THAT(refusal("\"LAB2\", \"LAB3\"", "-1"), HasSubstr("above -1"));
}

TEST_F(PilotCommand, TwoBoundsOfOnePairAreRefused) {
  const auto refusal = [&](const std::string& second) {
    write_protocol("",
                   "[[correlation_bound]]\nname = \"net\"\nparticipants = [\"LAB2\", \"LAB3\"]\n"
                   "correlation = 0.9\nquantities = [\"s_u\"]\n[[correlation_bound]]\nname = \"other\"\n" +
                       second);
    return pilot({"status", "c.toml"}).err;
  };
  // They would cancel, and the report would deny what the first alone shows.
  EXPECT_THAT(refusal("participants = [\"LAB4\", \"LAB3\", \"LAB2\"]\ncorrelation = -0.4\n"),
              AllOf(HasSubstr("LAB2, LAB3"), HasSubstr("one bound for them; \"net\" is another")));
  EXPECT_EQ(refusal("participants = [\"LAB4\", \"LAB3\"]\ncorrelation = -0.4\n"), "");
  EXPECT_EQ(refusal("participants = [\"LAB2\", \"LAB3\"]\ncorrelation = -0.4\nquantities = [\"s_v\"]\n"), "");
}

TEST_F(PilotCommand, ParticipantThatDiffersIsNamed) {
  write_protocol("procedure = \"subset\"\n");
  Made off;
  for (std::size_t q = 3; q < 6; ++q) off.values[q] += 0.01;
  add_all({{4, off}});
  const Json json = analysis(1);
  EXPECT_EQ(json["named"], Json::array({"LAB3"}));
  EXPECT_EQ(json["participants"][2]["contributes"][0], false);
  EXPECT_THAT(pilot({"analyse", "c.toml"}).out,
              AllOf(HasSubstr("LAB3 (phi_"), HasSubstr(") differs from the others, which agree.")));
}

TEST_F(PilotCommand, ProtocolIsReadOnceAndItsChangesAreStated) {
  add_all();
  write_protocol("procedure = \"B\"\n");
  EXPECT_THAT(pilot({"analyse", "c.toml"}).err, HasSubstr("changed since the comparison began"));
  ASSERT_EQ(pilot({"add", "c.toml", "--protocol-change", "agreed by all on 2026-07-01"}).exit_code, 0);
  const Json json = analysis(0);
  EXPECT_EQ(json["reference"]["procedure"], "B");
  EXPECT_THAT(json["notes"].dump(), HasSubstr("the protocol was changed: agreed by all"));
}

TEST_F(PilotCommand, ChainThatWasChangedIsFound) {
  add_all();
  std::string chain = test::read_file(folder / "c.toml.chain");
  const std::size_t at = chain.find("LAB3");
  ASSERT_NE(at, std::string::npos);
  chain.replace(at, 4, "LAB4");
  test::write_file(folder / "c.toml.chain", chain);
  const ProgramResult result = pilot({"analyse", "c.toml"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, HasSubstr("entry 5 was changed, moved or damaged"));
}

TEST_F(PilotCommand, ProtocolWithMistakesIsRefusedWithAllOfThem) {
  test::write_file(folder / "c.toml",
                   "[comparison]\nname = \"two\"\npilot = \"LAB9\"\nitem_serial_number = \"17\"\n"
                   "response_unit = \"V\"\nprocedure = \"C\"\nrepeatability = [1e-6]\n"
                   "[[participant]]\nname = \"LAB1\"\n[[participant]]\nname = \"LAB2\"\n"
                   "[[measurement]]\nparticipant = \"LAB1\"\n");
  const ProgramResult result = pilot({"status", "c.toml"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, AllOf(HasSubstr("2 participants"), HasSubstr("LAB9"), HasSubstr("none by LAB2"),
                                HasSubstr("procedure"), HasSubstr("one for each quantity")));
}

}  // namespace
}  // namespace abcal
