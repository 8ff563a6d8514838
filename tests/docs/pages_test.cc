// Link targets of the pages exist, and quoted messages equal those of the program.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <vector>

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
