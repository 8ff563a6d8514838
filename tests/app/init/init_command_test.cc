// `abcal init` over pseudo-terminals: from instruments to a bench file with which a run finds the truth; and
// everything that a person may do instead.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <regex>
#include <sstream>

#include "app/bench_file/bench_config.h"
#include "tests/app/program_fixtures.h"
#include "tests/support/typed_program.h"

namespace abcal {
namespace {

using test::Program;
using test::ProgramResult;
using test::Typed;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr const char* kCtrlC = "\x03";

/// A text as a person reads it who does not mind where lines end.
std::string in_one_line(const std::string& text) {
  return std::regex_replace(text, std::regex("\\s+"), " ");
}

/// The widest line that stays on the screen, in bytes.
std::size_t widest_line(const std::string& shown) {
  std::size_t widest = 0;
  std::istringstream lines(std::regex_replace(shown, std::regex("[^\n]*\r\x1b\\[K"), ""));
  for (std::string line; std::getline(lines, line);) {
    if (line.ends_with('\r')) line.pop_back();
    widest = std::max(widest, line.size());
  }
  return widest;
}

/// A bench whose instruments are emulated in a process of their own.
class InitFrom : public EmulatedBenchTest {
 protected:
  void serve(const std::string& simulation) {
    bench.simulation = simulation;
    test::write_file(folder / "truth.toml", bench.text() + "[stage.z]\nsign = -1\n");
    emulator = std::make_unique<Program>(
        std::vector<std::string>{"emulate", "truth.toml", "--link-dir", "links"}, folder.path());
    ASSERT_TRUE(test::wait_for([&] { return std::filesystem::exists(folder / "links/accelerometer"); },
                               std::chrono::seconds(20)))
        << emulator->err();
  }

  /// The command with an answer to every question, except those of `unanswered`.
  static std::vector<std::string> init(const std::vector<std::string>& unanswered = {}) {
    std::vector<std::string> words{"init"};
    const std::vector<std::pair<std::string, std::string>> answers{{"--stage", "links/stage"},
                                                                   {"--item", "links/accelerometer"},
                                                                   {"--travel", "-365 365"},
                                                                   {"--place", "g 9.81 0.0002"},
                                                                   {"--operator", "N. N."}};
    for (const auto& [option, answer] : answers) {
      if (std::find(unanswered.begin(), unanswered.end(), option) != unanswered.end()) continue;
      words.push_back(option);
      words.push_back(answer);
    }
    if (std::find(unanswered.begin(), unanswered.end(), "--yes") == unanswered.end())
      words.emplace_back("--yes");
    return words;
  }

  Typed type(const std::vector<std::string>& arguments, const test::Typist& typist) {
    return test::type_at_terminal(arguments, folder.path(), typist);
  }

  /// No bench file, and no beginning of one.
  bool nothing_is_written() {
    for (const auto& entry : std::filesystem::directory_iterator(folder.path())) {
      const std::string name = entry.path().filename().string();
      if (name.find("bench") != std::string::npos) return false;
    }
    return true;
  }
};

/// Its item is mounted as "-y x z", and its Z counts against the right-hand rule.
class InitTest : public InitFrom {
 protected:
  void SetUp() override {
    serve("sensitivity_matrix = [[0.01, -1.002, 0.02], [0.998, 0.015, -0.01], [0.012, 0.008, 1.001]]\n");
  }
};

TEST_F(InitTest, WritesABenchFileWithWhichACheckPassesAndARunFindsTheTruth) {
  const ProgramResult made = abcal(init());
  ASSERT_EQ(made.exit_code, 0) << made.out << made.err;
  EXPECT_THAT(made.out,
              AllOf(HasSubstr("along \"-y x z\""), HasSubstr("Z -1"), HasSubstr("fit for a run"),
                    HasSubstr("Sizes that are still defaults"), HasSubstr("[stage_uncertainty] wobble_urad"),
                    HasSubstr("abcal run bench.toml")));
  const BenchConfig config = read_bench(folder / "bench.toml");
  EXPECT_EQ(config.items.front().expected.mounting, "-y x z");
  EXPECT_EQ(config.stage.z.sign, -1);
  EXPECT_EQ(config.stage.x.zero.deg(), 0.0);
  EXPECT_EQ(config.items.front().item.serial_number, "6284.123456");

  const ProgramResult again = abcal(init());
  EXPECT_EQ(again.exit_code, 2);
  EXPECT_THAT(again.err,
              AllOf(HasSubstr("bench.toml"), HasSubstr("exists already"), Not(HasSubstr("--force"))));

  std::string quick = test::read_file(folder / "bench.toml");
  for (const auto& [usual, short_one] :
       std::vector<std::pair<std::string, std::string>>{{"steps = 72", "steps = 12"},
                                                        {"step_deg = 5.0", "step_deg = 30.0"},
                                                        {"settle_s = \"auto\"", "settle_s = 0.05"},
                                                        {"dwell_readings = 1000", "dwell_readings = 10"},
                                                        {"warm_up_s = 1800.0", "warm_up_s = 0.0"},
                                                        {"stability_s = 60.0", "stability_s = 0.0"}}) {
    ASSERT_NE(quick.find(usual), std::string::npos) << usual;
    quick.replace(quick.find(usual), usual.size(), short_one);
  }
  test::write_file(folder / "quick.toml", quick);
  const ProgramResult run = abcal({"run", "quick.toml", "-o", "a.run"});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  const ProgramResult truth = abcal({"analyse", "a.run", "--truth", "truth.toml"});
  EXPECT_EQ(truth.exit_code, 0) << truth.out << truth.err;
  // With the other sign of Z the same readings give another matrix: the comparison can fail.
  const std::string wrong = std::regex_replace(test::read_file(folder / "truth.toml"),
                                               std::regex("0\\.998, 0\\.015"), "0.998, 0.018");
  test::write_file(folder / "wrong.toml", wrong);
  EXPECT_EQ(abcal({"analyse", "a.run", "--truth", "wrong.toml"}).exit_code, 1);
}

TEST_F(InitTest, AMissingAnswerWithoutATerminalNamesItsOption) {
  for (const char* option : {"--stage", "--item", "--travel", "--place", "--operator", "--yes"}) {
    const ProgramResult result = abcal(init({option}));
    EXPECT_EQ(result.exit_code, 2) << option;
    EXPECT_THAT(result.err, AllOf(HasSubstr("no terminal"), HasSubstr(std::string("\n  ") + option)));
  }
  const ProgramResult none = abcal({"init", "--travel", "-20 20", "--place", "Berlin"});
  for (const char* words : {"--stage emulated", "--item PORT", "--operator NAME", "--yes",
                            "--travel \"-20 20\": ", "--place \"Berlin\": "})
    EXPECT_THAT(none.err, HasSubstr(words));
  EXPECT_THAT(none.err, Not(HasSubstr("--travel \"MIN MAX\"")));
  EXPECT_TRUE(nothing_is_written());
}

TEST_F(InitTest, NonsenseIsAskedAgainAndNothingIsTurnedWithoutAYes) {
  const std::vector<std::string> answers{"",
                                         "7",
                                         "COM3",
                                         "/dev/nothing",
                                         "links/accelerometer",
                                         "links/stage",  // the stage
                                         "links/stage",
                                         "emulated",
                                         "links/accelerometer",  // the item
                                         "far",
                                         "-20 20",
                                         "-30 30",
                                         "-365 365",  // the travel
                                         "Berlin",
                                         "52,3 80",
                                         "52.3 80",  // the place
                                         "",
                                         "N. N.",  // who
                                         "perhaps",
                                         "no"};
  const Typed typed = type({"init"}, test::answers_to("> ", answers));
  EXPECT_EQ(typed.exit_code, 130) << typed.shown;
  for (const char* words :
       {"none answers", "required: a port", "/dev/nothing", "an accelerometer answers", "a stage answers",
        "--stage emulated", "both sides of zero", "decimal point", "name of the person", "found \"perhaps\"",
        "not homed", "emergency stop", "nothing has moved"})
    EXPECT_THAT(in_one_line(typed.shown), HasSubstr(words));
  // The last line is a command, which is to be copied.
  EXPECT_LE(widest_line(typed.shown.substr(0, typed.shown.find("The same answers again"))), 80U)
      << typed.shown;
  EXPECT_TRUE(nothing_is_written());
}

TEST_F(InitTest, CtrlCAtEachQuestionLeavesNothing) {
  for (const char* option : {"--stage", "--item", "--travel", "--place", "--operator", "--yes"}) {
    bool is_typed = false;
    const Typed typed = type(init({option}), [&](const std::string& shown) -> std::optional<std::string> {
      if (is_typed || !shown.ends_with("> ")) return std::nullopt;
      is_typed = true;
      return kCtrlC;
    });
    EXPECT_EQ(typed.exit_code, 130) << option << typed.shown;
    EXPECT_THAT(typed.shown, HasSubstr("no bench file is written")) << option;
    EXPECT_TRUE(nothing_is_written()) << option;
  }
}

TEST_F(InitTest, CtrlCDuringTheTurnHaltsTheStageAndLeavesNoFile) {
  int typed_keys = 0;
  const Typed typed = type(init({"--yes"}), [&](const std::string& shown) -> std::optional<std::string> {
    if (typed_keys == 0 && shown.ends_with("> ")) {
      ++typed_keys;
      return "yes\n";
    }
    if (typed_keys == 1 && shown.find("Turning both axes") != std::string::npos) {
      ++typed_keys;
      return kCtrlC;
    }
    return std::nullopt;
  });
  EXPECT_EQ(typed_keys, 2) << typed.shown;
  EXPECT_EQ(typed.exit_code, 130) << typed.shown;
  EXPECT_THAT(typed.shown,
              AllOf(HasSubstr("the stage is halted"), HasSubstr("No bench file is written"),
                    HasSubstr("abcal init --stage links/stage --item links/accelerometer "
                              "--travel '-365 365' --place 'g 9.81 0.0002' --operator 'N. N.'")));
  EXPECT_TRUE(nothing_is_written());
  // Its ports are free again, and the stage obeys.
  EXPECT_EQ(abcal({"check", "truth.toml"}).exit_code, 1) << "the item is not along x, y, z";
}

TEST_F(InitTest, APortInUseIsSaidSo) {
  ProgramResult second;
  bool is_asked = false;
  const Typed typed = type(init({"--yes"}), [&](const std::string& shown) -> std::optional<std::string> {
    if (is_asked || !shown.ends_with("> ")) return std::nullopt;
    is_asked = true;
    second = abcal(init());
    return "no\n";
  });
  EXPECT_EQ(typed.exit_code, 130);
  EXPECT_EQ(second.exit_code, 3) << second.err;
  EXPECT_THAT(second.err, AllOf(HasSubstr("links/stage"), HasSubstr("in use")));
  EXPECT_TRUE(nothing_is_written());
}

TEST_F(InitTest, AnAxisWhereItsCableMayNotBeIsRefusedBeforeAnythingMoves) {
  // The first turn goes to the other side, and is interrupted while X stands at -30 degrees.
  std::vector<std::string> arguments = init({"--travel"});
  arguments.insert(arguments.end(), {"--travel", "-365 5"});
  bool is_typed = false;
  const Typed first = type(arguments, [&](const std::string& shown) -> std::optional<std::string> {
    if (is_typed || shown.find("67 %") == std::string::npos) return std::nullopt;
    is_typed = true;
    return kCtrlC;
  });
  EXPECT_EQ(first.exit_code, 130) << first.shown;
  arguments.back() = "-5 400";
  const ProgramResult second = abcal(arguments);
  EXPECT_EQ(second.exit_code, 3) << second.err;
  EXPECT_THAT(second.err,
              AllOf(HasSubstr("stage axis X"), HasSubstr("stands at -30.0"), HasSubstr("required: -5 to"),
                    HasSubstr("Nothing has moved"), Not(HasSubstr("Turn now"))));
  EXPECT_TRUE(nothing_is_written());
  // Where it may be there, its place is said.
  const Typed third = type(init({"--yes"}), test::answers_to("> ", {"no"}));
  EXPECT_THAT(third.shown, AllOf(HasSubstr("X: now at -30.0"), HasSubstr("Allowed: -360 to 360 degrees"),
                                 HasSubstr("The stage turns twice")));
}

TEST_F(InitFrom, AnItemAskewLeavesNoFileAndTheAnswersAreNotLost) {
  serve("sensitivity_matrix = [[0.866, 0.5, 0.0], [-0.5, 0.866, 0.0], [0.0, 0.0, 1.0]]\n");
  const ProgramResult made = abcal(init());
  EXPECT_EQ(made.exit_code, 1) << made.out << made.err;
  EXPECT_THAT(made.err,
              AllOf(HasSubstr("turned by 30 degrees from the nearest position"),
                    HasSubstr("No bench file is written. The same answers again:\n  abcal init --stage")));
  EXPECT_TRUE(nothing_is_written());
}

TEST_F(InitFrom, ABenchThatIsNotFitIsCheckedAgainInsteadOfRun) {
  // Gravity shows the mounting, but the outputs are wrong by 15 %.
  serve("sensitivity_matrix = [[1.15, 0.0, 0.0], [0.0, 1.15, 0.0], [0.0, 0.0, 1.15]]\n");
  const ProgramResult made = abcal(init());
  EXPECT_EQ(made.exit_code, 1) << made.out << made.err;
  EXPECT_THAT(made.out, AllOf(HasSubstr("not fit for a run"),
                              HasSubstr("abcal check bench.toml\n      again"), Not(HasSubstr("abcal run"))));
}

TEST_F(ProgramTest, InitIsInterruptedWhileASilentPortIsAsked) {
  const int listening = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  ASSERT_EQ(::bind(listening, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  ASSERT_EQ(::listen(listening, 20), 0);
  socklen_t size = sizeof address;
  ::getsockname(listening, reinterpret_cast<sockaddr*>(&address), &size);
  bool is_typed = false;
  const Typed typed =
      test::type_at_terminal({"init", "--stage", "tcp:127.0.0.1:" + std::to_string(ntohs(address.sin_port)),
                              "--item", "/dev/nothing"},
                             folder.path(), [&](const std::string& shown) -> std::optional<std::string> {
                               if (is_typed || shown.find(" for ") == std::string::npos) return std::nullopt;
                               is_typed = true;
                               return kCtrlC;
                             });
  ::close(listening);
  EXPECT_TRUE(is_typed) << typed.shown;
  EXPECT_EQ(typed.exit_code, 130) << typed.shown;
  EXPECT_THAT(typed.shown, AllOf(HasSubstr("no bench file is written"), Not(HasSubstr("no instrument that")),
                                 Not(HasSubstr("for watl"))));
}

TEST_F(ProgramTest, InitOffersTheEmulatedBench) {
  const Typed typed =
      test::type_at_terminal({"init", "--travel", "-100 365", "--place", "52.3 80", "--operator", "N. N."},
                             folder.path(), test::answers_to("> ", {"emulated"}));
  EXPECT_EQ(typed.exit_code, 0) << typed.shown;
  EXPECT_THAT(typed.shown, AllOf(HasSubstr("Nothing real moves"), HasSubstr("fit for a run"),
                                 HasSubstr("abcal emulate bench.toml --link-dir")));
  EXPECT_EQ(abcal({"plan", "bench.toml"}).exit_code, 0);
  EXPECT_FALSE(std::filesystem::exists(folder / "bench-emulated")) << "its links are gone, and so is it";
  const ProgramResult own = abcal({"init", "--stage", "emulated", "--item", "/dev/ttyUSB0", "-o", "b.toml"});
  EXPECT_EQ(own.exit_code, 2);
  EXPECT_THAT(own.err, HasSubstr("has an item of its own"));
}

}  // namespace
}  // namespace abcal
