// docs/tutorial.md at a terminal, word for word: its commands in an empty folder, and what it shows of their
// output.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <regex>
#include <string>
#include <string_view>
#include <vector>

#include "tests/app/tutorial_page.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/typed_program.h"

namespace abcal {
namespace {

using test::Figures;
using test::PageStep;
using testing::AllOf;
using testing::HasSubstr;

constexpr const char* kCtrlC = "\x03";
constexpr const char* kPassword = "correct horse 7";

/// The highest percentage that a progress bar has shown.
int percent_in(const std::string& shown) {
  static const std::regex percent("([0-9]+) %");
  int highest = 0;
  for (std::sregex_iterator each(shown.begin(), shown.end(), percent), end; each != end; ++each)
    highest = std::max(highest, std::stoi((*each)[1]));
  return highest;
}

/// A shell at a terminal, whose prompt tells the exit code of the command before.
class ShellAtTerminal {
 public:
  ShellAtTerminal(const std::filesystem::path& folder, std::map<std::string, std::string> environment)
      : bash_("/bin/bash", {"--noprofile", "--norc", "--noediting", "-i"}, folder,
              with_prompt(std::move(environment))) {
    await_prompt(false);
  }

  struct Done {
    int exit_code = -1;
    std::string shown;  ///< As the terminal shows it in the end, without the command and the prompt.
  };

  /// Types a command, waits for the next prompt, and answers every question: passwords are all that is asked.
  /// @param interrupts  Ctrl-C is typed once the progress bar has passed the middle
  Done run(const std::string& command, bool interrupts = false) {
    from_ = bash_.shown().size();
    bash_.type(command + "\n");
    return await_prompt(interrupts);
  }

  /// Types a command that does not end, and waits until it shows these words.
  void start(const std::string& command, const std::string& awaited) {
    from_ = bash_.shown().size();
    bash_.type(command + "\n");
    while (bash_.shown().find(awaited, from_) == std::string::npos) read_more();
  }
  Done interrupt() {
    bash_.type(kCtrlC);
    return await_prompt(false);
  }

 private:
  /// A line that is not ended, as output is too that arrives in parts.
  static bool asks_for_password(const std::string& shown) {
    static const std::regex question("(password[^\n]*|once more): $");
    return std::regex_search(shown.substr(shown.find_last_of('\n') + 1), question);
  }
  static std::map<std::string, std::string> with_prompt(std::map<std::string, std::string> environment) {
    environment["PS1"] = "[$?]tutorial> ";
    environment["TERM"] = "dumb";
    environment["HISTFILE"] = "";
    return environment;
  }

  void read_more() {
    if (!bash_.read_more()) throw std::runtime_error("the shell has ended: " + bash_.shown());
  }

  Done await_prompt(bool interrupts) {
    std::size_t answered = 0;
    while (!bash_.shown().ends_with("]tutorial> ") || bash_.shown().size() == from_) {
      read_more();
      const std::string since = bash_.shown().substr(from_);
      if (interrupts && percent_in(since) >= 50) {
        bash_.type(kCtrlC);
        interrupts = false;
      }
      if (asks_for_password(since) && since.size() > answered) {
        answered = since.size();
        bash_.type(std::string(kPassword) + "\n");
      }
    }
    std::string shown = test::as_shown(bash_.shown().substr(from_));
    const std::size_t prompt = shown.rfind('[');
    const int exit_code = std::atoi(shown.c_str() + prompt + 1);
    shown.resize(prompt);
    shown.erase(0, shown.find('\n') + 1);  // the command itself
    return {exit_code, shown};
  }

  test::ProgramAtTerminal bash_;
  std::size_t from_ = 0;  ///< Where the output of the command begins.
};

bool is_missing(const std::string& program) {
  return std::system(("command -v " + program + " >/dev/null").c_str()) != 0;
}

std::string& replace_first(std::string& text, std::string_view old, std::string_view now) {
  const std::size_t at = text.find(old);
  if (at == std::string::npos) throw std::runtime_error("not there: " + std::string(old));
  return text.replace(at, old.size(), now);
}

/// "line 34": where this stands in a text.
std::string line_of(const std::string& text, std::string_view what) {
  const auto end = text.begin() + static_cast<std::ptrdiff_t>(text.find(what));
  return "line " + std::to_string(1 + std::count(text.begin(), end, '\n'));
}

/// Walks through the page.
class TutorialTest : public testing::Test {
 protected:
  void SetUp() override {
    for (const char* program : {"weasyprint", "gnuplot"})
      if (is_missing(program)) GTEST_SKIP() << program << " is not installed, and the page makes a report";
    std::filesystem::create_directory(folder / "bin");
    std::filesystem::create_symlink(test::abcal_program(), folder / "bin/abcal");
    std::filesystem::create_directory(folder / "empty");
    environment["PATH"] = (folder / "bin").string() + ":" + std::getenv("PATH");
    environment["HOME"] = environment["XDG_STATE_HOME"] = folder.path().string();
    ::unsetenv("ABCAL_REGISTER");
    shell = std::make_unique<ShellAtTerminal>(folder / "empty", environment);
  }

  void follow(const PageStep& step, Figures figures) {
    std::string shown;
    for (const std::string& command : step.commands) {
      SCOPED_TRACE(command);
      const std::string output = carry_out(step, command);
      if (!output.empty()) shown = output;
    }
    if (!step.output.empty()) {
      EXPECT_EQ(test::difference_from_page(step.output, shown, figures), "")
          << step.commands.back() << " shows\n"
          << shown;
    }
    heed(step);
  }

  /// The page has made its files, and its prose was heeded: a sentence that is worded in another way would
  /// otherwise not be tried any more.
  void look_at_the_end() {
    for (const char* file : {"first.run", "second.run", "first.html", "first.pdf", "first.csv", "first.h5",
                             "first.xml", "training.db", "twice.measurement", "twice.html", "twice.xml"})
      EXPECT_TRUE(std::filesystem::exists(first / file)) << file;
    EXPECT_EQ(interrupted, 1) << "Ctrl-C";
    EXPECT_EQ(mistakes, 1) << "two mistakes";
    EXPECT_EQ(changed, 1) << "one byte changed";
    ASSERT_TRUE(second_terminal);
    EXPECT_EQ(second_terminal->interrupt().exit_code, 0);
  }

  const std::vector<PageStep> page =
      test::steps_of_page(test::read_file(test::source_folder() / "docs/tutorial.md"));
  test::TemporaryFolder folder;
  const std::filesystem::path first = folder / "empty";

 private:
  std::string carry_out(const PageStep& step, std::string command) {
    // The examples are those of the sources, wherever the package abcal-doc has put its own.
    constexpr std::string_view kInstalled = "/usr/share/doc/abcal/examples";
    if (command.find(kInstalled) != std::string::npos)
      replace_first(command, kInstalled, (test::source_folder() / "docs/examples").string());
    if (step.prose_before.find("In a second terminal, in the same folder") != std::string::npos) {
      second_terminal = std::make_unique<ShellAtTerminal>(first, environment);
      second_terminal->start(command, "Serving until interrupted");
      return {};
    }
    const bool interrupts = step.prose_after.find("Press Ctrl-C in the middle") != std::string::npos;
    interrupted += interrupts ? 1 : 0;
    const ShellAtTerminal::Done done = shell->run(command, interrupts);
    EXPECT_EQ(done.exit_code, interrupts ? 130 : 0) << done.shown;
    return done.shown;
  }

  /// Tries what the prose after a step tells the reader to try.
  void heed(const PageStep& step) {
    const std::string prose = test::unwrapped(step.prose_after);
    if (prose.find("Make two mistakes on purpose: write `rate_hz = -5` and `stepps = 72`") !=
        std::string::npos) {
      ++mistakes;
      make_two_mistakes();
    }
    if (prose.find("Change one byte (`chmod u+w`, then a hex editor), and it reports the change") !=
        std::string::npos) {
      ++changed;
      change_one_byte();
    }
  }
  void make_two_mistakes() {
    const std::string right = test::read_file(first / "bench.toml");
    std::string text = right;
    replace_first(text, "rate_hz = 100.0", "rate_hz = -5");
    replace_first(text, "\nsteps = 72", "\nstepps = 72");
    test::write_file(first / "bench.toml", text);
    const ShellAtTerminal::Done plan = shell->run("abcal plan bench.toml");
    test::write_file(first / "bench.toml", right);
    EXPECT_EQ(plan.exit_code, 2);
    EXPECT_THAT(plan.shown, AllOf(HasSubstr(line_of(text, "rate_hz = -5") + ", [accelerometer] rate_hz"),
                                  HasSubstr(line_of(text, "stepps = 72") + ", [protocol] stepps")));
  }
  void change_one_byte() {
    EXPECT_EQ(shell->run("chmod u+w first.run").exit_code, 0);
    std::string bytes = test::read_file(first / "first.run");
    char& byte = bytes[bytes.size() / 2];
    byte = static_cast<char>(byte ^ 1);
    test::write_file(first / "first.run", bytes);
    const ShellAtTerminal::Done verify = shell->run("abcal verify first.run");
    EXPECT_EQ(verify.exit_code, 1) << verify.shown;
  }

  std::map<std::string, std::string> environment;
  std::unique_ptr<ShellAtTerminal> shell, second_terminal;
  int interrupted = 0, mistakes = 0, changed = 0;  ///< How often the prose asked for it.
};

/// Everything, with the runs cut from three times 72 angles to three times 8: their figures are others then.
TEST_F(TutorialTest, IsFollowedWordForWordWithShortRuns) {
  Figures figures = Figures::kOfThePage;
  for (const PageStep& step : page) {
    if (figures == Figures::kOfThePage && step.commands.front().starts_with("abcal run ")) {
      figures = Figures::kAny;
      std::string bench = test::read_file(first / "bench.toml");
      replace_first(bench, "\nsteps = 72\nstep_deg = 5.0\n", "\nsteps = 8\nstep_deg = 45.0\n");
      test::write_file(first / "bench.toml", bench);
    }
    follow(step, figures);
  }
  EXPECT_EQ(figures, Figures::kAny);
  look_at_the_end();
}

class LongTutorialTest : public TutorialTest {};

/// As it stands, in five minutes.
TEST_F(LongTutorialTest, IsFollowedWordForWord) {
  for (const PageStep& step : page) follow(step, Figures::kOfThePage);
  look_at_the_end();
}

/// The comparison itself.
class PageOutputTest : public testing::Test {
 protected:
  static std::string difference(const std::string& page, const std::string& output) {
    return test::difference_from_page(page, output, Figures::kOfThePage);
  }
};

TEST_F(PageOutputTest, AFigureThatChangedIsFound) {
  const std::string output =
      "No problem: 227 angles,\n  about 1 min 08 s\nAngles: 227; 20 readings at each\n";
  EXPECT_EQ(difference("No problem: 227 angles, about\n...\nAngles: 227; 20 readings at each\n", output), "");
  EXPECT_THAT(difference("No problem: 228 angles, about\n...\nAngles: 227; 20 readings at each\n", output),
              HasSubstr("not in the output: \"228"));
  EXPECT_THAT(difference("...\nAngles: 227; 21 readings at each\n", output), HasSubstr("\"21 readings"));
}

TEST_F(PageOutputTest, WordsThatThePageLeavesOutWithoutSayingSoAreFound) {
  const std::string output = "one\ntwo\nthree\n";
  EXPECT_EQ(difference("one\n...\n", output), "");
  EXPECT_EQ(difference("...\nthree\n", output), "");
  EXPECT_EQ(difference("one\ntwo ...\n", output), "");
  EXPECT_EQ(difference("one\ntw...\n", output), "");
  EXPECT_NE(difference("one\nto...\n", output), "");
  EXPECT_THAT(difference("one\ntwo\n", output), HasSubstr("the page leaves out \"three\""));
  EXPECT_THAT(difference("two\nthree\n", output), HasSubstr("not in the output: \"two three\""));
  EXPECT_THAT(difference("one\nthree\n", output), HasSubstr("not in the output: \"three\""));
  EXPECT_THAT(difference("one\n...\ntwo\n", output), HasSubstr("the page leaves out \"three\""));
}

TEST_F(PageOutputTest, AValueMayDifferByItsUncertaintyAndAStatisticOfNoiseByAnything) {
  EXPECT_EQ(difference("u +1.002126 +- 0.000024\n", "u +1.002106 +- 0.000029\n"), "");
  EXPECT_NE(difference("u +1.002126 +- 0.000024\n", "u +1.002096 +- 0.000024\n"), "");
  EXPECT_NE(difference("u +1.002126 +- 0.000024\n", "u +1.002126 +- 0.000040\n"), "");
  EXPECT_EQ(difference("chi2 536.5 for 645 degrees\n", "chi2 514.6 for 645 degrees\n"), "");
  EXPECT_NE(difference("chi2 536.5 for 645 degrees\n", "chi2 514.6 for 644 degrees\n"), "");
  EXPECT_EQ(
      difference("certificate T-2026-0001 of 2026-11-21:\n", "certificate T-2027-0001 of 2027-01-02:\n"), "");
  EXPECT_NE(
      difference("certificate T-2026-0001 of 2026-11-21:\n", "certificate T-2026-0002 of 2026-11-21:\n"), "");
}

TEST_F(PageOutputTest, ATerminalShowsWhatIsLeftOfAProgressBar) {
  EXPECT_EQ(test::as_shown("\rRun [#.] 40 %\x1b[K\rRun [##] 100 %\x1b[K\r\x1b[K\x1b[1mdone\x1b[0m\r\n"),
            "done\n");
}

}  // namespace
}  // namespace abcal
