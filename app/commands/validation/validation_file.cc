#include "app/commands/validation/validation_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "app/commands/validation/requirements.h"
#include "app/formats/xml_query.h"
#include "app/system/read_file.h"
#include "drivers/text/names.h"

namespace abcal {
namespace {

constexpr const char* kHead =
    "# Validation\n\n"
    "Evidence that the program fulfils its requirements (ISO/IEC 17025, 7.11.2). Each requirement has the "
    "risk if it\n"
    "fails, the functions or source files that fulfil it, and tests that fail if they do not. The tests run "
    "with\n"
    "`scripts/test` (the quick ones within minutes, those named Long on request), also under sanitizers. "
    "`TEST --gtest_filter=NAME`\n"
    "runs a single one. That each test executes one of the functions is verified by coverage "
    "(`scripts/release requirements-coverage`).\n"
    "The last section lists what tests cannot show.\n\n";

constexpr const char* kTail =
    "## What tests cannot show\n\n"
    "- That a real stage keeps its stated uncertainties: measure them (`abcal level`, the joint estimator's "
    "step errors), and compare\n"
    "  with a laboratory that has other equipment ([comparing.md](comparing.md)).\n"
    "- That an instrument behaves as its maker's manual says: simulated firmware is written from the manual. "
    "Drivers that have not\n"
    "  yet met their instrument say so in [drivers/](drivers).\n"
    "- That local gravity and the conditions of the room are as typed in.\n";

constexpr const char* kHowTo =
    "## The file of a laboratory\n\n"
    "`abcal self-test` checks an installation within a minute: libraries; the programs that belong to it "
    "(each starts, and is of\n"
    "the same version); schemas, tools, ports, disk and clock; the paper's tables; a simulated run against "
    "its truth, and its\n"
    "verification. `abcal self-test --file` prints this page with the version, the checks of this "
    "installation and the last\n"
    "result of each test. The results come from a run of the tests of the same version:\n\n"
    "```\n"
    "GTEST_OUTPUT=xml:$PWD/results/ scripts/test\n"
    "abcal self-test --file --results results > validation-file.md\n"
    "```\n\n"
    "Without `--results` it says that the tests were not run here. This page is made with `abcal self-test "
    "--page`.\n\n";

/// A bar would end the cell of a Markdown table.
std::string in_cell(std::string text) {
  for (std::size_t at = text.find('|'); at != std::string::npos; at = text.find('|', at + 2))
    text.insert(at, "\\");
  return text;
}

/// "Suite.Name" of a test, without the parts that an instance of parameters adds: "OnBothDatabases/Suite",
/// "Name/Sqlite".
std::string plain_name(const std::string& suite, const std::string& name) {
  const std::size_t begin = suite.find('/');
  std::string plain = begin == std::string::npos ? suite : suite.substr(begin + 1);
  plain = plain.substr(0, plain.find('/'));
  return plain + "." + name.substr(0, name.find('/'));
}

std::string attribute(xmlNode* node, const char* name) {
  return owned_text(xmlGetNoNsProp(node, reinterpret_cast<const xmlChar*>(name)));
}

void read_one(const std::filesystem::path& file, TestResults& results) {
  const XmlDocument document = parse_xml(read_file(file, kLargestXml), file.string());
  const XmlQuery query(document.get());
  for (xmlNode* one : query.nodes("//testcase")) {
    const std::string name = plain_name(attribute(one, "classname"), attribute(one, "name"));
    const bool ran = attribute(one, "status") == "run" && attribute(one, "result") != "skipped";
    const TestResults::Outcome outcome = !query.nodes("failure", one).empty() ? TestResults::Outcome::kFailed
                                         : ran                                ? TestResults::Outcome::kPassed
                                               : TestResults::Outcome::kSkipped;
    const auto [place, is_new] = results.outcomes.emplace(name, outcome);
    // The worst of all instances; a skipped instance does not count against one that passed.
    if (!is_new &&
        (outcome == TestResults::Outcome::kFailed || place->second == TestResults::Outcome::kSkipped))
      place->second = outcome;
  }
  for (xmlNode* root : query.nodes("/testsuites"))
    results.last_utc = std::max(results.last_utc, attribute(root, "timestamp"));
}

constexpr auto kOutcomes = names<TestResults::Outcome>({{TestResults::Outcome::kPassed, "passed"},
                                                        {TestResults::Outcome::kFailed, "FAILED"},
                                                        {TestResults::Outcome::kSkipped, "skipped"}});

std::string outcome_words(const std::string& test, const TestResults* results) {
  if (results == nullptr) return "not run here";
  const auto found = results->outcomes.find(test);
  if (found == results->outcomes.end()) return "not run";
  return std::string(kOutcomes.of(found->second, "not run"));
}

/// Number of tests of a requirement that passed, and each test that did not.
std::string result_of(const Requirement& requirement, const TestResults* results) {
  std::string others;
  std::size_t passed = 0;
  for (const std::string& test : requirement.tests) {
    const std::string words = outcome_words(test, results);
    passed += words == "passed" ? 1 : 0;
    if (words != "passed" && results != nullptr) others += fmt::format("; `{}` {}", test, words);
  }
  if (results == nullptr) return "not run here";
  return fmt::format("{} of {} passed{}", passed, requirement.tests.size(), others);
}

std::string code_cell(const std::vector<std::string>& names) {
  std::string cell;
  for (const std::string& name : names) cell.append(cell.empty() ? "" : ", ").append("`" + name + "`");
  return cell;
}

/// @param results_column  whether the tables have a column with result_of()
std::string tables(bool results_column, const TestResults* results) {
  std::string text;
  for (const RequirementSection& section : requirements()) {
    text += fmt::format("## {}\n\n| requirement | risk | fulfilled by | shown by |{}\n|---|---|---|---|{}\n",
                        section.title, results_column ? " last result |" : "", results_column ? "---|" : "");
    for (const Requirement& one : section.requirements)
      text += fmt::format("| {} | {} | {} | {} |{}\n", in_cell(one.words), in_cell(one.risk),
                          one.code.empty() ? "the pages" : code_cell(one.code), code_cell(one.tests),
                          results_column ? fmt::format(" {} |", result_of(one, results)) : "");
    text += "\n";
  }
  return text;
}

}  // namespace

TestResults read_test_results(const std::filesystem::path& folder) {
  TestResults results;
  std::error_code error;
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    if (entry.path().extension() != ".xml") continue;
    read_one(entry.path(), results);
    ++files;
  }
  if (files == 0)
    throw std::invalid_argument(fmt::format(
        "{}: holds no results; required: what tests wrote with GTEST_OUTPUT=xml:FOLDER/", folder.string()));
  return results;
}

std::string validation_page() {
  return kHead + tables(false, nullptr) + kHowTo + kTail;
}

std::string validation_file(const ValidationFacts& facts, const std::vector<SelfCheck>& checks,
                            const TestResults* results) {
  std::string text = fmt::format(
      "# Software validation file\n\n- Program: abcal {}\n- Made: {} on {}\n- Tests: {}\n- Self-test: {}\n\n",
      facts.version, facts.created_utc, facts.host,
      results == nullptr ? "not run here"
                         : fmt::format("last run {}; whoever ran them states that they are of this version",
                                       results->last_utc),
      all_good(checks) ? "all good" : "NOT GOOD");
  text += "## This installation\n\n| check | result | found |\n|---|---|---|\n";
  for (const SelfCheck& check : checks) {
    const char* grade = check.grade == SelfCheck::Grade::kGood   ? "good"
                        : check.grade == SelfCheck::Grade::kNote ? "note"
                                                                 : "BAD";
    text +=
        fmt::format("| {}: {} | {} | {} |\n", check.group, in_cell(check.what), grade, in_cell(check.found));
  }
  return text + "\n" + tables(true, results) + kTail;
}

}  // namespace abcal
