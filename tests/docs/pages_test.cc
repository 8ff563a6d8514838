// Link targets of the pages exist, and quoted messages equal those of the program.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <filesystem>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "protocol/estimators/shared/calibration_result.h"
#include "protocol/record/run_record.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::HasSubstr;

const std::filesystem::path kRoot = test::source_folder();

/// README.md, CONTRIBUTING.md and all below docs/.
std::vector<std::filesystem::path> pages() {
  std::vector<std::filesystem::path> found{kRoot / "README.md", kRoot / "CONTRIBUTING.md"};
  for (const auto& entry : std::filesystem::recursive_directory_iterator(kRoot / "docs"))
    if (entry.path().extension() == ".md") found.push_back(entry.path());
  return found;
}

/// The lines outside of blocks of code.
std::vector<std::string> prose(const std::filesystem::path& page) {
  std::vector<std::string> lines;
  std::istringstream text(test::read_file(page));
  bool code = false;
  for (std::string line; std::getline(text, line);) {
    if (line.starts_with("```")) {
      code = !code;
    } else if (!code) {
      lines.push_back(line);
    }
  }
  return lines;
}

/// The anchors of a page as the usual servers of Markdown make them: "## The XML file!" is #the-xml-file.
std::set<std::string> anchors(const std::filesystem::path& page) {
  std::set<std::string> found;
  for (const std::string& line : prose(page)) {
    if (!line.starts_with('#')) continue;
    std::string anchor;
    for (const char c : line.substr(std::min(line.find(' ') + 1, line.size()))) {
      const auto byte = static_cast<unsigned char>(c);
      if (std::isalnum(byte) != 0 || c == '-' || c == '_') anchor += static_cast<char>(std::tolower(byte));
      if (c == ' ') anchor += '-';
    }
    found.insert(anchor);
  }
  return found;
}

TEST(PagesTest, EveryLinkAndPictureIsThere) {
  const std::regex link(R"(\]\(([^)\s]+)\))");
  int links = 0;
  for (const std::filesystem::path& page : pages()) {
    for (const std::string& line : prose(page)) {
      for (std::sregex_iterator match(line.begin(), line.end(), link), end; match != end; ++match) {
        const std::string target = (*match)[1];
        if (target.find("://") != std::string::npos) continue;
        ++links;
        const std::size_t at = std::min(target.find('#'), target.size());
        const std::filesystem::path file = at == 0 ? page : page.parent_path() / target.substr(0, at);
        ASSERT_TRUE(std::filesystem::exists(file)) << page << " points at " << target;
        const bool found = at == target.size() || anchors(file).contains(target.substr(at + 1));
        EXPECT_TRUE(found) << page << " points at " << target << ", but there is no such heading";
      }
    }
  }
  EXPECT_GT(links, 40);
}

/// All sources, with texts that are broken over lines in one piece.
std::string sources() {
  std::string all;
  for (const char* folder : {"app", "drivers", "protocol", "sim"}) {
    for (const auto& entry : std::filesystem::recursive_directory_iterator(kRoot / folder)) {
      const std::string extension = entry.path().extension();
      if (extension == ".cc" || extension == ".h") all += test::read_file(entry.path());
    }
  }
  std::string joined;
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (all[i] == '"') {
      const std::size_t next = all.find_first_not_of(" \n", i + 1);
      if (next != std::string::npos && all[next] == '"' && all.find('\n', i) < next) {
        i = next;
        continue;
      }
    }
    joined += all[i];
  }
  return joined;
}

TEST(PagesTest, TroubleshootingListsWhatTheProgramSays) {
  const std::string all = sources();
  const std::regex quoted("`([^`]*)`");
  // Variable parts: "...", a number N, a FILE; and parts that a colon joins.
  const std::regex varies(R"(\.\.\.|\bN\b|\bFILE\b|:)");
  int parts = 0;
  for (const std::string& line : prose(kRoot / "docs/troubleshooting.md")) {
    if (!line.starts_with("| ") || line.find("abcal-console.service") != std::string::npos) continue;
    const std::string message = line.substr(2, line.find(" |", 2) - 2);
    for (std::sregex_iterator match(message.begin(), message.end(), quoted), end; match != end; ++match) {
      const std::string text = (*match)[1];
      for (std::sregex_token_iterator part(text.begin(), text.end(), varies, -1), none; part != none;
           ++part) {
        const std::string words = std::regex_replace(part->str(), std::regex(R"(^[ ()]+|[ ()]+$)"), "");
        if (words.size() < 4) continue;
        ++parts;
        EXPECT_NE(all.find(words), std::string::npos) << "the program never says \"" << words << '"';
      }
    }
  }
  EXPECT_GT(parts, 40);
}

/// The rows of a page below one heading, up to the next heading of any level: cells without their marks of
/// code.
std::vector<std::vector<std::string>> rows_below(const std::string& heading,
                                                 const std::filesystem::path& page) {
  std::vector<std::vector<std::string>> rows;
  bool below = false;
  for (const std::string& line : prose(page)) {
    if (line.starts_with('#')) below = line == heading;
    if (!below || !line.starts_with("| ")) continue;
    std::vector<std::string> cells;
    for (std::size_t at = 2, bar = 0; (bar = line.find(" |", at)) != std::string::npos; at = bar + 3)
      cells.push_back(line.substr(at, bar - at));
    rows.push_back(std::move(cells));
  }
  return rows;
}

/// The first cells of a table, which quote the program, as a set of their quotations.
std::set<std::string> quotations_below(const std::string& heading) {
  std::set<std::string> quoted;
  const std::regex code("`([^`]*)`");
  for (const std::vector<std::string>& cells : rows_below(heading, kRoot / "docs/troubleshooting.md")) {
    EXPECT_EQ(cells.size(), 3U) << heading << ": " << cells.front();
    for (const std::string& cell : cells) EXPECT_FALSE(cell.empty()) << heading << ": " << cells.front();
    for (std::sregex_iterator match(cells.front().begin(), cells.front().end(), code), end; match != end;
         ++match)
      quoted.insert((*match)[1]);
  }
  return quoted;
}

TEST(PagesTest, EveryVerdictAndFlagHasItsCauseAndRemedy) {
  const std::set<std::string> verdicts = quotations_below("## The verdict");
  for (const Verdict verdict : {Verdict::kUsable, Verdict::kDoubtful, Verdict::kNotUsable}) {
    std::string word(to_string(verdict));
    std::ranges::replace(word, '_', ' ');
    EXPECT_TRUE(verdicts.contains(word)) << word;
  }
  const std::set<std::string> flags = quotations_below("## Flags of angles");
  std::size_t known = 0;
  for (std::uint32_t flag = 1; flag != 0; flag *= 2) {
    const std::string words = describe_flags(flag);
    if (words.empty()) continue;
    ++known;
    EXPECT_TRUE(flags.contains(words)) << "docs/troubleshooting.md has no flag `" << words << '`';
  }
  EXPECT_EQ(flags.size(), known) << "and no other";
}

/// The names that meaning_of_check() knows.
TEST(PagesTest, EveryCheckHasItsCauseAndRemedy) {
  std::string text = test::read_file(kRoot / "protocol/estimators/checks/check_meanings.cc");
  text.erase(text.find("meaning_of_flag"));
  const std::set<std::string> checks = quotations_below("## Checks of a run");
  const std::regex entry(R"re(\{"([^"]+)",\s*"[^"]*"\})re");
  std::size_t known = 0;
  for (std::sregex_iterator match(text.begin(), text.end(), entry), end; match != end; ++match, ++known) {
    // The page names a check of each output without the output.
    const std::string name = std::regex_replace((*match)[1].str(), std::regex(R"( (of )?\{output\}.*)"), "");
    EXPECT_TRUE(checks.contains(name)) << "docs/troubleshooting.md has no check `" << name << '`';
  }
  EXPECT_GE(known, 18U);
}

/// Each message with which an estimator doubts or refuses a result: its text, without what varies.
std::vector<std::string> reasons_of_estimators() {
  std::vector<std::string> reasons;
  const std::regex raised(R"re((objections\.add|contradictions\.push_back|UnusableData)\(([\s\S]*?)\);)re");
  const std::regex text(R"re("([^"]*)")re");
  for (const auto& entry : std::filesystem::recursive_directory_iterator(kRoot / "protocol/estimators")) {
    if (entry.path().extension() != ".cc") continue;
    const std::string source = test::read_file(entry.path());
    for (std::sregex_iterator match(source.begin(), source.end(), raised), end; match != end; ++match) {
      const std::string call = (*match)[2];
      std::string words;
      for (std::sregex_iterator part(call.begin(), call.end(), text), none; part != none; ++part)
        words += (*part)[1];
      if (words.size() > 20) reasons.push_back(words);
    }
  }
  return reasons;
}

TEST(PagesTest, EveryReasonOfADoubtfulOrUnusableResultHasItsCauseAndRemedy) {
  std::vector<std::string> parts;
  for (const char* heading : {"### Why is my calibration doubtful?", "### Why is my calibration not usable?",
                              "## Checks of a run"}) {
    for (const std::string& quoted : quotations_below(heading)) {
      std::string longest;  // between the parts that vary
      for (std::size_t at = 0; at < quoted.size();) {
        const std::size_t varies = std::min(quoted.find("...", at), quoted.size());
        if (varies - at > longest.size()) longest = quoted.substr(at, varies - at);
        at = varies + 3;
      }
      if (longest.size() > 7) parts.push_back(longest);
    }
  }
  const std::vector<std::string> reasons = reasons_of_estimators();
  EXPECT_GE(reasons.size(), 20U);
  for (const std::string& reason : reasons) {
    EXPECT_TRUE(std::ranges::any_of(
        parts, [&](const std::string& part) { return reason.find(part) != std::string::npos; }))
        << "docs/troubleshooting.md has no row for \"" << reason << '"';
  }
}

TEST(PagesTest, TheFrontPageLeadsToEachPage) {
  const std::string front = test::read_file(kRoot / "docs/index.md");
  for (const auto& entry : std::filesystem::directory_iterator(kRoot / "docs")) {
    const std::string name = entry.path().filename().string();
    if (entry.path().extension() != ".md" || name == "index.md") continue;
    EXPECT_THAT(front, HasSubstr("](" + name)) << "docs/index.md does not name " << name;
  }
}

/// The words in bold are the titles of sections, in their order; the paragraphs behind the list have others.
TEST(PagesTest, AReportHasTheSectionsThatItsPageLists) {
  const test::TemporaryFolder folder;
  const std::string bench = kRoot / "docs/examples/simulated.toml";
  ASSERT_EQ(test::run_program({"run", bench, "-o", "a.run"}, folder.path()).exit_code, 0);
  const test::ProgramResult report = test::run_program({"report", "a.run"}, folder.path());
  ASSERT_EQ(report.exit_code, 0) << report.err;
  const std::string page = test::read_file(kRoot / "docs/report.md");
  const std::size_t from = page.find("## What is in it");
  const std::size_t end = page.find("**U = k u", from);
  std::size_t seen = 0, sections = 0;
  const std::regex section(R"(\*\*([^*]+)\*\*)");
  const std::string listed = page.substr(from, end - from);
  for (std::sregex_iterator match(listed.begin(), listed.end(), section), none; match != none; ++match) {
    const std::size_t at = report.out.find("\n" + (*match)[1].str() + "\n", seen);
    EXPECT_NE(at, std::string::npos) << "the report has no section " << (*match)[1];
    if (at != std::string::npos) seen = at;
    ++sections;
  }
  EXPECT_GE(sections, 12U);
}

}  // namespace
}  // namespace abcal
