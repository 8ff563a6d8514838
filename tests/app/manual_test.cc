// Manual pages and completions as used by a system: troff that man accepts, scripts that bash runs.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "tests/app/program_fixtures.h"

namespace abcal {
namespace {

using test::ProgramResult;
using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;
using testing::IsSupersetOf;
using testing::Not;

class ManualTest : public ProgramTest {
 protected:
  ManualTest() { written = abcal({"--write-manual", "manual"}); }
  std::string page(const std::string& name) { return test::read_file(folder / "manual" / name); }
  /// Output and errors of a shell command; its exit code must be 0.
  std::string shell(const std::string& command) {
    test::Program program("/bin/sh", {"-c", command + " 2>&1"}, folder.path());
    const int code = program.wait();
    EXPECT_EQ(code, 0) << command << "\n" << program.out();
    return program.out();
  }
  /// Completions that bash offers while the last of `words` is being typed.
  std::vector<std::string> completions(const std::vector<std::string>& words) {
    std::string list;
    for (const std::string& word : words) list += "'" + word + "' ";
    test::write_file(folder / "complete.sh",
                     "set -u; source manual/abcal.bash\nCOMP_WORDS=(" + list +
                         ")\nCOMP_CWORD=$((${#COMP_WORDS[@]} - 1))\nCOMPREPLY=()\n_abcal\n"
                         "printf '%s\\n' \"${COMPREPLY[@]}\"\n");
    std::istringstream lines(shell("bash complete.sh"));
    std::vector<std::string> found;
    for (std::string line; std::getline(lines, line);) found.push_back(line);
    return found;
  }
  ProgramResult written;
};

TEST_F(ManualTest, EveryCommandHasAPageWithItsOptions) {
  ASSERT_EQ(written.exit_code, 0) << written.err;
  EXPECT_EQ(written.out, "");
  const std::string main_page = page("abcal.1");
  const std::string help = abcal({"--help"}).out;
  int commands = 0;
  std::istringstream lines(help.substr(help.find("Prepare a bench:")));
  for (std::string line; std::getline(lines, line) && !line.starts_with('`');) {
    if (!line.starts_with("  ") || line.starts_with("   "))
      continue;  // A group, or a description's second line.
    const std::string name = line.substr(2, line.find_first_of(" ,", 2) - 2);  // "analyse, analyze"
    ++commands;
    const std::string troff = page("abcal-" + name + ".1");
    std::string escaped_name = name;
    if (const std::size_t dash = name.find('-'); dash != std::string::npos) escaped_name.insert(dash, "\\");
    EXPECT_THAT(main_page, HasSubstr("abcal\\-" + escaped_name)) << name;
    // Every long option of the command's own help is in its page.
    std::istringstream words(abcal({name, "--help"}).out);
    for (std::string word; words >> word;) {
      if (!word.starts_with("--")) continue;
      word = word.substr(0, word.find_first_of(",.;:)"));
      std::string escaped;
      for (const char c : word) escaped += c == '-' ? "\\-" : std::string(1, c);
      EXPECT_THAT(troff, HasSubstr(escaped)) << name << " " << word;
    }
  }
  EXPECT_GE(commands, 12);
  EXPECT_THAT(main_page, Not(HasSubstr("write\\-manual")));
  EXPECT_THAT(page("abcal-run.1"), AllOf(HasSubstr("emergency stop"), HasSubstr(".SH EXIT STATUS")));
}

TEST_F(ManualTest, TroffIsTakenWithoutAWarning) {
  ASSERT_EQ(written.exit_code, 0) << written.err;
  if (std::system("command -v groff >/dev/null") != 0) GTEST_SKIP() << "groff is not installed";
  for (const auto& entry : std::filesystem::directory_iterator(folder / "manual")) {
    if (entry.path().extension() != ".1") continue;
    const std::string output =
        shell("groff -man -Tutf8 -ww -wall manual/" + entry.path().filename().string() + " >/dev/null");
    EXPECT_EQ(output, "") << entry.path();
  }
}

TEST_F(ManualTest, BashCompletesCommandsOptionsChoicesAndFiles) {
  ASSERT_EQ(written.exit_code, 0) << written.err;
  shell("bash -n manual/abcal.bash");
  EXPECT_THAT(completions({"abcal", ""}), IsSupersetOf({"run", "resume", "compare", "gravity", "--help"}));
  EXPECT_EQ(completions({"abcal", "comp"}), std::vector<std::string>{"compare"});
  EXPECT_THAT(completions({"abcal", "compare", "--"}), IsSupersetOf({"--json", "--shared", "--estimator"}));
  EXPECT_THAT(completions({"abcal", "compare", "--"}), Not(Contains("--latitude")));
  EXPECT_EQ(completions({"abcal", "analyse", "--estimator", "jo"}), std::vector<std::string>{"joint"});
  EXPECT_THAT(completions({"abcal", "gravity", "--formula", ""}), IsSupersetOf({"grs80", "welmec"}));
  test::write_file(folder / "my bench.toml", "");
  EXPECT_THAT(completions({"abcal", "run", "my"}), Contains("my bench.toml"));
}

TEST_F(ManualTest, BashCompletesNestedCommandsAndTheFilesOfEachKind) {
  ASSERT_EQ(written.exit_code, 0) << written.err;
  EXPECT_THAT(completions({"abcal", "lab", ""}), IsSupersetOf({"init", "login", "add", "verify"}));
  EXPECT_THAT(completions({"abcal", "lab", "add", ""}), AllOf(Contains("person"), Not(Contains("login"))));
  EXPECT_THAT(completions({"abcal", "lab", "add", "person", "--"}), Contains("--role"));
  for (const char* name : {"a.run", "b.toml", "c.txt"}) test::write_file(folder / name, "");
  EXPECT_THAT(completions({"abcal", "resume", ""}), AllOf(Contains("a.run"), Not(Contains("b.toml"))));
  EXPECT_THAT(completions({"abcal", "plan", ""}), AllOf(Contains("b.toml"), Not(Contains("c.txt"))));
  EXPECT_THAT(completions({"abcal", "plan", "c"}), Contains("c.txt")) << "all files where none fits";
}

TEST_F(ManualTest, EveryPageHasExamplesEnvironmentFilesAndExitStatus) {
  ASSERT_EQ(written.exit_code, 0) << written.err;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "manual")) {
    if (entry.path().extension() != ".1") continue;
    const std::string troff = test::read_file(entry.path());
    for (const char* section : {".SH ENVIRONMENT", ".SH FILES", ".SH EXIT STATUS"})
      EXPECT_THAT(troff, HasSubstr(section)) << entry.path();
    const bool is_of_a_command = entry.path().stem() != "abcal";
    EXPECT_EQ(troff.find(".SH EXAMPLES") != std::string::npos, is_of_a_command) << entry.path();
  }
}

/// Words of a person who does not know the program.
class FirstWordsTest : public ProgramTest {};

TEST_F(FirstWordsTest, TheProgramAloneShowsItsCommandsInGroups) {
  const ProgramResult result = abcal({});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err,
              AllOf(HasSubstr("Prepare a bench:"), HasSubstr("Measure:"), HasSubstr("abcal help COMMAND")));
  EXPECT_THAT(result.err, Not(HasSubstr("required")));
}

TEST_F(FirstWordsTest, HelpIsACommandToo) {
  EXPECT_EQ(abcal({"help"}).out, abcal({"--help"}).out);
  const ProgramResult run = abcal({"help", "run"});
  EXPECT_EQ(run.exit_code, 0);
  EXPECT_EQ(run.out, abcal({"run", "--help"}).out);
  EXPECT_THAT(run.out, AllOf(HasSubstr("BENCH"), HasSubstr("Examples:\n  abcal run ")));
  EXPECT_EQ(abcal({"help", "lab", "add", "person"}).out, abcal({"lab", "add", "person", "--help"}).out);
  EXPECT_EQ(abcal({"-v"}).out, abcal({"--version"}).out);
  EXPECT_THAT(abcal({"-h"}).out, HasSubstr("Measure:"));
}

TEST_F(FirstWordsTest, AnUnknownCommandIsNamedWithTheOneThatWasMeant) {
  for (const auto& [word, meant] : std::vector<std::pair<std::string, std::string>>{
           {"rum", "abcal run"}, {"resme", "abcal resume"}, {"uncertainity", "abcal uncertainty"}}) {
    const ProgramResult result = abcal({word, "a.run"});
    EXPECT_EQ(result.exit_code, 2);
    EXPECT_THAT(result.err, AllOf(HasSubstr("there is no command \"" + word + "\""),
                                  HasSubstr("did you mean `" + meant + "`?")));
  }
  EXPECT_THAT(abcal({"lab", "logn"}).err, HasSubstr("did you mean `abcal lab login`?"));
  EXPECT_THAT(abcal({"frobnicate"}).err, AllOf(HasSubstr("one of"), HasSubstr("uncertainty")));
  EXPECT_THAT(abcal({"help", "rum"}).err, HasSubstr("did you mean `abcal run`?"));
}

TEST_F(FirstWordsTest, AnalyzeIsAnalyse) {
  EXPECT_THAT(abcal({"analyze"}).err, HasSubstr("FILE is required"));
  EXPECT_EQ(abcal({"analyze", "--help"}).exit_code, 0);
}

TEST_F(ManualTest, ZshCompletionIsAScript) {
  ASSERT_EQ(written.exit_code, 0) << written.err;
  const std::string script = page("_abcal");
  EXPECT_THAT(script, AllOf(HasSubstr("#compdef abcal"), HasSubstr("'compare:"), HasSubstr("--formula[")));
  if (std::system("command -v zsh >/dev/null") == 0) shell("zsh -n manual/_abcal");
}

TEST_F(ManualTest, PagesCarryTheDateOfTheSources) {
  ASSERT_EQ(::setenv("SOURCE_DATE_EPOCH", "1780272000", 1), 0);  // 2026-06-01
  const ProgramResult again = abcal({"--write-manual", "dated"});
  ::unsetenv("SOURCE_DATE_EPOCH");
  ASSERT_EQ(again.exit_code, 0);
  EXPECT_THAT(test::read_file(folder / "dated/abcal.1"), HasSubstr("\"2026-06-01\""));
  EXPECT_THAT(page("abcal.1"), HasSubstr(".TH \"ABCAL\" 1 \"\""));
}

}  // namespace
}  // namespace abcal
