// Output that nobody reads: closed pipes, full disks, closed descriptors. None of them ends a run.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/app/program_fixtures.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using namespace std::chrono_literals;

class BrokenOutputTest : public EmulatedBenchTest {
 protected:
  /// Runs a script in which "abcal" is the program, as `sh -c` does. Its exit code is that of the script.
  test::ProgramResult shell(const std::string& script) {
    const std::vector<std::string> words{"-c",
                                         "abcal() { '" + test::abcal_program() + "' \"$@\"; }\n" + script};
    test::Program sh(std::string("/bin/sh"), words, folder.path());
    const int exit_code = sh.wait();
    return {exit_code, sh.out(), sh.err()};
  }
  /// The program's exit code if a pipe hides it: the script writes it to `code`.
  int code() const { return std::stoi(test::read_file(folder / "code")); }
  RunState state(const std::string& run) const { return RunFile::load(folder / run).state; }
};

TEST_F(BrokenOutputTest, ARunGoesOnWhenItsReaderHasGone) {
  write_bench({});
  shell("{ abcal run bench.toml -o a.run; echo $? >code; } 2>&1 | head -1");
  EXPECT_EQ(state("a.run"), RunState::kComplete);
  EXPECT_EQ(code(), 1);  // Its result reached nobody.
  const test::ProgramResult silent =
      shell("{ abcal run bench.toml -o b.run 2>&3; echo $? >code; } 3>&1 >b.out | head -1");
  EXPECT_EQ(state("b.run"), RunState::kComplete);
  EXPECT_EQ(code(), 0) << silent.err;
  EXPECT_THAT(test::read_file(folder / "b.out"), HasSubstr("Result: usable"));
}

TEST_F(BrokenOutputTest, AFullDiskUnderStandardErrorLosesWordsOnly) {
  write_bench({});
  const test::ProgramResult result = shell("abcal run bench.toml -o a.run 2>/dev/full");
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_THAT(result.out, HasSubstr("Result: usable"));
  EXPECT_EQ(shell("abcal plan absent.toml 2>/dev/full").exit_code, 2);
}

TEST_F(BrokenOutputTest, AFullDiskUnderStandardOutputIsAFailureThatIsSaid) {
  write_bench({});
  const test::ProgramResult run = shell("abcal run bench.toml -o a.run >/dev/full");
  EXPECT_EQ(run.exit_code, 1);
  EXPECT_THAT(run.err, HasSubstr("could not be written to standard output"));
  EXPECT_EQ(state("a.run"), RunState::kComplete);
  for (const char* command : {"plan bench.toml", "analyse a.run --json", "gravity --latitude 47 --height 400",
                              "--version", "--help", "run --help", "instruments"}) {
    const test::ProgramResult result = shell(std::string("abcal ") + command + " >/dev/full");
    EXPECT_EQ(result.exit_code, 1) << command;
    EXPECT_THAT(result.err, HasSubstr("No space left on device")) << command;
  }
  EXPECT_EQ(shell("abcal --version >/dev/full 2>/dev/full").exit_code, 1);
}

TEST_F(BrokenOutputTest, ClosedDescriptorsAreNotTakenByFilesOrPorts) {
  write_bench({});
  const test::ProgramResult words = shell("abcal run bench.toml -o a.run 2>&-");
  EXPECT_EQ(words.exit_code, 0);
  EXPECT_THAT(words.out, HasSubstr("Result: usable"));
  const test::ProgramResult results = shell("abcal run bench.toml -o b.run >&-");
  EXPECT_EQ(results.exit_code, 1);
  EXPECT_THAT(results.err, HasSubstr("could not be written to standard output"));
  EXPECT_EQ(shell("abcal run bench.toml -o c.run <&-").exit_code, 0);
  EXPECT_EQ(shell("abcal run bench.toml -o d.run <&- >&- 2>&-").exit_code, 1);
  for (const char* run : {"a.run", "b.run", "c.run", "d.run"}) {
    EXPECT_EQ(state(run), RunState::kComplete) << run;
    EXPECT_EQ(abcal({"verify", run}).exit_code, 0) << run;
  }
  // A CSV that took descriptor 1 would contain the printed text.
  shell("abcal report a.run --csv whole.csv");
  shell("abcal report a.run --csv closed.csv >&- 2>&-");
  const auto content = [&](const std::string& csv) {
    const std::string text = test::read_file(folder / csv);
    const std::size_t line = text.find("# written_utc");  // the only one that differs
    return text.substr(0, line) + text.substr(std::min(text.size(), text.find('\n', line)));
  };
  EXPECT_THAT(content("whole.csv"), HasSubstr("experiment,n"));
  EXPECT_EQ(content("closed.csv"), content("whole.csv"));
}

TEST_F(BrokenOutputTest, CtrlCThatEndsTheReaderTooLeavesAResumableRunWithItsReason) {
  bench.protocol = "steps = 12\nstep_deg = 30.0\nsettle_s = 0.2\ndwell_readings = 20\n";
  start_emulator();
  const std::string script = "trap : INT\n{ trap : INT; '" + test::abcal_program() +
                             "' run bench.toml -o a.run; echo $? >code; } 2>&1 | tee log\n";
  test::Program sh(std::string("/bin/sh"), std::vector<std::string>{"-c", script}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return measured("a.run") >= 2; }, 60s)) << sh.err();
  ::kill(-sh.pid(), SIGINT);  // Ctrl-C in a terminal reaches every process of the pipe.
  sh.wait();
  ASSERT_TRUE(test::wait_for([&] { return !test::read_file(folder / "code").empty(); }, 20s));
  EXPECT_EQ(code(), 130);
  const StoredRun run = RunFile::load(folder / "a.run");
  EXPECT_EQ(run.state, RunState::kInterrupted);
  ASSERT_FALSE(run.events.empty());
  EXPECT_THAT(run.events.back().text, HasSubstr("halted")) << run.events.back().kind;
  EXPECT_EQ(abcal({"resume", "a.run"}).exit_code, 0);
}

/// A bench whose accelerometer reports no identity, so that [item] may name any.
BenchText without_identity() {
  BenchText bench;
  bench.accelerometer_driver = "simulated";
  return bench;
}

TEST_F(BrokenOutputTest, NothingOfABenchFileIsObeyedByATerminal) {
  bench.stage_driver = "\\u001b]0;title\\u0007\\u202e\\u009b2J";
  write_bench(bench);
  const test::ProgramResult refused = abcal({"plan", "bench.toml"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("found \"\\u001b]0;title\\u0007\\u202e\\u009b2J\""));

  const std::string item = "[item]\nmodel = \"TA\\u001b[31m\\u202e\"\nserial_number = \"\\u009b1\"\n";
  test::write_file(folder / "item.toml", item + without_identity().text());
  const test::ProgramResult run = abcal({"run", "item.toml", "-o", "a.run"});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  const test::ProgramResult report = abcal({"report", "a.run"});
  const test::ProgramResult json = abcal({"report", "a.run", "--json"});
  for (const std::string& text : {refused.err, run.out, run.err, report.out, report.err, json.out}) {
    EXPECT_EQ(text.find('\x1b'), std::string::npos) << text;
    EXPECT_EQ(text.find("\u202e"), std::string::npos) << text;
    EXPECT_EQ(text.find("\u009b"), std::string::npos) << text;
  }
  EXPECT_THAT(report.out, HasSubstr("[31m\\u202e"));
  EXPECT_TRUE(nlohmann::json::accept(json.out));
}

TEST_F(BrokenOutputTest, NothingOfABenchFileIsObeyedByAReaderOfAnExport) {
  const std::string item =
      "[item]\nmodel = \"TA\\u001b[31m\\u202e\\nint x;\"\nserial_number = \"\\u009b1\"\n";
  test::write_file(folder / "item.toml", item + without_identity().text());
  ASSERT_EQ(abcal({"run", "item.toml", "-o", "a.run"}).exit_code, 0);
  std::vector<std::vector<std::string>> exports{{"report", "a.run", "--csv"}};
  for (const char* format : {"json", "csv", "c", "px4", "ardupilot", "ros", "imucal"})
    exports.push_back({"export", "a.run", "--as", format, "-o"});
  for (std::vector<std::string>& words : exports) {
    const std::string file = words.at(words.size() - 2) + ".out";
    words.push_back(file);
    const test::ProgramResult made = abcal(words);
    ASSERT_EQ(made.exit_code, 0) << made.err;
    const std::string text = test::read_file(folder / file);
    for (const std::string obeyed : {"\x1b", "\u202e", "\u009b", "\nint x"})
      EXPECT_EQ(text.find(obeyed), std::string::npos) << file << ": " << text.substr(0, 500);
  }
}

TEST_F(BrokenOutputTest, ABenchFileThatNestsWithoutEndIsRefused) {
  const auto repeated = [](const std::string& text, int times) {
    std::string all;
    for (int i = 0; i < times; ++i) all += text;
    return all;
  };
  const std::vector<std::string> files{
      repeated("a.", 50'000) + "a = 1\n", "[" + repeated("a.", 50'000) + "a]\n",
      "a = " + repeated("{a.b.c = ", 20'000), "a = " + repeated("[", 100'000),
      "a = {" + repeated("\"x\" . ", 50'000) + "a = 1}\n"};
  for (const std::string& text : files) {
    test::write_file(folder / "deep.toml", "# a \"comment\" ''' [[[\n" + text);
    const test::ProgramResult result = abcal({"plan", "deep.toml"});
    EXPECT_EQ(result.exit_code, 2) << text.substr(0, 30);
    EXPECT_THAT(result.err, HasSubstr("line 2: found tables or lists nested too deeply"))
        << text.substr(0, 30);
  }
}

TEST_F(BrokenOutputTest, AMessageIsSomeKilobytesLongWhateverTheFileHolds) {
  std::string many = "[bench]\n";
  for (int i = 0; i < 5000; ++i) many += "key" + std::to_string(i) + " = 1\n";
  const std::string huge(5'000'000, 'x');
  for (const std::string& text : {many, "[stage]\ndriver = \"" + huge + "\"\n", huge + " = 1\n",
                                  "[" + huge + "]\n", "[bench]\nname = [" + huge + "\n"}) {
    test::write_file(folder / "long.toml", text);
    const test::ProgramResult result = abcal({"plan", "long.toml"});
    EXPECT_EQ(result.exit_code, 2) << text.substr(0, 30);
    EXPECT_LT(result.err.size(), 20'000U) << text.substr(0, 30);
    EXPECT_THAT(result.err, HasSubstr("required: ")) << text.substr(0, 30);
  }
  EXPECT_THAT(shell("truncate -s 17M zeros.toml; abcal plan zeros.toml").err,
              HasSubstr("found more than 16 MiB"));
}

/// The local addresses, as the kernel writes them, on which this TCP port is listened to.
std::vector<std::string> listening_addresses(int port) {
  std::vector<std::string> found;
  for (const char* table : {"/proc/net/tcp", "/proc/net/tcp6"}) {
    std::istringstream lines(test::read_file(table));
    for (std::string line; std::getline(lines, line);) {
      std::istringstream words(line);
      std::string number, local, remote, state;
      words >> number >> local >> remote >> state;
      const auto colon = local.rfind(':');
      if (state == "0A" && std::stoi(local.substr(colon + 1), nullptr, 16) == port)
        found.push_back(local.substr(0, colon));
    }
  }
  return found;
}

TEST_F(BrokenOutputTest, TheEmulatorListensOnTheLoopbackUnlessAnAddressIsGiven) {
  const std::vector<std::pair<std::string, std::string>> cases{
      {"tcp:0", "0100007F"}, {"tcp::0", "0100007F"}, {"tcp:0.0.0.0:0", "00000000"}};
  for (const auto& [port, address] : cases) {
    BenchText served;
    served.stage_port = port;
    write_bench(served);
    const test::Program emulate({"emulate", "bench.toml", "--link-dir", "links"}, folder.path());
    ASSERT_TRUE(test::wait_for([&] { return emulate.out().find("Serving") != std::string::npos; }, 20s))
        << emulate.err();
    const std::string out = emulate.out();
    const std::string line = out.substr(0, out.find('\n'));
    EXPECT_EQ(listening_addresses(std::stoi(line.substr(line.rfind(':') + 1))),
              std::vector<std::string>{address})
        << port << ": " << line;
  }
  BenchText wrong;
  wrong.stage_port = "tcp:host:port";
  write_bench(wrong);
  const test::ProgramResult refused = abcal({"emulate", "bench.toml"});
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("\"port\" is not a port number"));
}

}  // namespace
}  // namespace abcal
