// `abcal demo` as a new user starts it, the pages that messages name, and passwords that are typed.

#include <arpa/inet.h>
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>

#include "tests/app/program_fixtures.h"
#include "tests/support/project_paths.h"
#include "tests/support/typed_program.h"

namespace abcal {
namespace {

using test::Program;
using test::ProgramResult;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

class DemoTest : public ProgramTest {
 protected:
  /// The processes that were started in the folder of the test and still run: demo, bench, guard.
  int processes_left() {
    int count = 0;
    for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
      std::error_code gone;
      if (std::filesystem::read_symlink(entry.path() / "cwd", gone) ==
          std::filesystem::canonical(folder.path()))
        ++count;
    }
    return count;
  }
  std::set<std::string> runs() {
    std::set<std::string> names;
    for (const auto& entry : std::filesystem::directory_iterator(folder / "abcal-demo"))
      if (entry.path().extension() == ".run") names.insert("abcal-demo/" + entry.path().filename().string());
    return names;
  }
  std::size_t measured(const std::string& run) {
    try {
      return RunFile::load(folder / run).measured.size();
    } catch (const RunFileError&) {
      return 0;
    }
  }
};

/// The answer of a web server of this computer.
std::string answer_of(int port) {
  const int connection = ::socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  std::string text;
  if (::connect(connection, reinterpret_cast<sockaddr*>(&address), sizeof address) == 0) {
    const std::string request =
        "GET / HTTP/1.1\r\nHost: 127.0.0.1:" + std::to_string(port) + "\r\nConnection: close\r\n\r\n";
    std::array<char, 4096> bytes{};
    if (::send(connection, request.data(), request.size(), 0) > 0)
      for (ssize_t n = 0; (n = ::recv(connection, bytes.data(), bytes.size(), 0)) > 0;)
        text.append(bytes.data(), static_cast<std::size_t>(n));
  }
  ::close(connection);
  return text;
}

TEST_F(DemoTest, CalibratesAndReportsAndTheNextOneInterruptedLosesNothingAndLeavesNothing) {
  Program demo({"demo", "--steps", "8", "--json"}, folder.path());
  std::smatch port;
  ASSERT_TRUE(test::wait_for(
      [&] {
        const std::string err = demo.err();
        return std::regex_search(err, std::regex("http://127.0.0.1:[0-9]+/"));
      },
      std::chrono::seconds(20)))
      << demo.err();
  const std::string said = demo.err();
  ASSERT_TRUE(std::regex_search(said, port, std::regex("http://127.0.0.1:([0-9]+)/")));
  EXPECT_THAT(answer_of(std::stoi(port[1])), AllOf(HasSubstr("200 OK"), HasSubstr("abcal")));
  ASSERT_EQ(demo.wait(), 0) << demo.err();

  const Json json = Json::parse(demo.out());
  EXPECT_EQ(json["schema"], "abcal.demo/1");
  EXPECT_TRUE(json["agrees_with_true_values"].get<bool>());
  EXPECT_EQ(json["next"].size(), 3U);
  EXPECT_EQ(json["result"]["schema"], "abcal.result/1");
  const std::string run = json["run"], report = json["report"], bench = json["bench_file"];
  EXPECT_EQ(RunFile::load(folder / run).state, RunState::kComplete);
  EXPECT_THAT(test::read_file(folder / report), HasSubstr("</html>"));
  EXPECT_EQ(abcal({"analyse", run, "--truth", bench}).exit_code, 0);
  EXPECT_EQ(abcal({"plan", bench}).exit_code, 0);
  EXPECT_TRUE(test::wait_for([&] { return processes_left() == 0; }, std::chrono::seconds(10)));

  std::map<std::string, std::string> before;
  for (const std::string& file : {run, report, bench, run + ".results"})
    before[file] = test::read_file(folder / file);
  Program next({"demo", "--steps", "8", "--no-wait"}, folder.path());
  std::string second;
  ASSERT_TRUE(test::wait_for(
      [&] {
        for (const std::string& name : runs())
          if (name != run && measured(name) >= 2) second = name;
        return !second.empty();
      },
      std::chrono::seconds(60)))
      << next.err();
  next.signal(SIGINT);
  EXPECT_EQ(next.wait(), 130);
  EXPECT_THAT(next.err(), AllOf(HasSubstr("angles are measured and stored in " + second),
                                HasSubstr("its stage is halted and its processes have ended")));
  EXPECT_TRUE(test::wait_for([&] { return processes_left() == 0; }, std::chrono::seconds(10)));
  EXPECT_FALSE(std::filesystem::is_symlink(folder / "abcal-demo/stage"));
  EXPECT_EQ(RunFile::load(folder / second).state, RunState::kInterrupted);
  for (const auto& [file, bytes] : before)
    EXPECT_EQ(test::read_file(folder / file), bytes) << file << " was changed by a later demo";
}

TEST_F(DemoTest, RefusesWhatItCannotDoBeforeItStartsAnything) {
  EXPECT_THAT(abcal({"demo", "--steps", "7"}).err, HasSubstr("a divisor of 360"));
  const int lock = ::open((folder / "abcal-demo/.demo.lock").c_str(), O_RDWR);
  ASSERT_GE(lock, 0);
  ASSERT_EQ(::flock(lock, LOCK_EX | LOCK_NB), 0) << "a demo that was refused still holds its folder";
  const ProgramResult second = abcal({"demo"});
  ::close(lock);
  EXPECT_EQ(second.exit_code, 2);
  EXPECT_THAT(second.err, AllOf(HasSubstr("another demo"), HasSubstr("--dir")));
  ::setenv("ABCAL_REGISTER", (folder / "register.db").c_str(), 1);
  const ProgramResult registered = abcal({"demo"});
  ::unsetenv("ABCAL_REGISTER");
  EXPECT_EQ(registered.exit_code, 2);
  EXPECT_THAT(registered.err, HasSubstr("env -u ABCAL_REGISTER abcal demo"));
  EXPECT_EQ(processes_left(), 0);
}

TEST_F(DemoTest, ABenchFileThatAPersonHasChangedStaysAsItIs) {
  std::filesystem::create_directory(folder / "abcal-demo");
  test::write_file(folder / "abcal-demo/bench.toml", "# mine\n");
  Program demo({"demo", "--steps", "8", "--json"}, folder.path());
  ASSERT_TRUE(test::wait_for([&] { return demo.err().find("Console") != std::string::npos; },
                             std::chrono::seconds(20)))
      << demo.err();
  demo.signal(SIGINT);
  EXPECT_EQ(demo.wait(), 130);
  EXPECT_EQ(test::read_file(folder / "abcal-demo/bench.toml"), "# mine\n");
  EXPECT_THAT(test::read_file(folder / "abcal-demo/bench-2.toml"), HasSubstr("steps = 8"));
}

class DocsTest : public ProgramTest {};

TEST_F(DocsTest, ShowsEachPageThatTheProgramNames) {
  std::set<std::string> named;
  for (const char* part : {"app", "drivers", "protocol"}) {
    for (const auto& entry : std::filesystem::recursive_directory_iterator(test::source_folder() / part)) {
      if (entry.path().extension() != ".cc") continue;
      const std::string text = test::read_file(entry.path());
      const std::regex page("docs/([a-z0-9_/-]+\\.(md|toml))");
      for (std::sregex_iterator each(text.begin(), text.end(), page), end; each != end; ++each)
        named.insert((*each)[0]);
    }
  }
  ASSERT_GE(named.size(), 10U);
  for (const std::string& page : named) {
    const ProgramResult shown = abcal({"docs", page});
    EXPECT_EQ(shown.exit_code, 0) << page << ": " << shown.err;
    EXPECT_EQ(shown.out, test::read_file(test::source_folder() / page)) << page;
  }
}

TEST_F(DocsTest, ListsPagesFindsThemByTheirNameAndCorrectsASlip) {
  EXPECT_THAT(abcal({"docs"}).out,
              AllOf(HasSubstr("effects "), HasSubstr("what a real stage"), HasSubstr("tutorial ")));
  EXPECT_EQ(abcal({"docs", "effects.md#noise"}).out, abcal({"docs", "effects"}).out);
  const ProgramResult slip = abcal({"docs", "efects"});
  EXPECT_EQ(slip.exit_code, 2);
  EXPECT_THAT(slip.err, HasSubstr("`abcal docs effects`"));
  EXPECT_EQ(abcal({"docs", "../README"}).exit_code, 2);
}

TEST_F(DocsTest, NamesTheBuiltSiteOfAnInstallationAndListsOnlyItsPages) {
  const std::filesystem::path pages = folder / "share/doc/abcal";
  std::filesystem::create_directories(folder / "bin");
  std::filesystem::create_directories(pages / "site/_downloads");
  std::filesystem::copy_file(test::abcal_program(), folder / "bin/abcal");
  test::write_file(pages / "bench_file.md", "# The bench file\n");
  test::write_file(pages / "site/_downloads/real.toml", "");
  const auto docs = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "docs");
    test::Program program((folder / "bin/abcal").string(), arguments, folder.path());
    const int code = program.wait();
    return ProgramResult{code, program.out(), program.err()};
  };
  EXPECT_THAT(docs({}).out, AllOf(HasSubstr("The bench file"), Not(HasSubstr("With a search"))));
  test::write_file(pages / "site/index.html", "<h1>abcal</h1>");
  const ProgramResult listed = docs({});
  EXPECT_EQ(listed.exit_code, 0) << listed.err;
  EXPECT_THAT(listed.out, HasSubstr("With a search, in a browser: file://" +
                                    std::filesystem::canonical(pages).string() + "/site/index.html\n"));
  EXPECT_EQ(docs({"site/_downloads/real.toml"}).exit_code, 2);
}

/// A program at a terminal, and a person who answers its prompts.
class TypedTest : public ProgramTest {
 protected:
  test::Typed type(const std::vector<std::string>& arguments, const std::vector<std::string>& answers) {
    return test::type_at_terminal(arguments, folder.path(), test::answers_to(": ", answers),
                                  {{"ABCAL_REGISTER", (folder / "register.db").string()},
                                   {"XDG_STATE_HOME", (folder / "state").string()}});
  }
};

TEST_F(TypedTest, ANewPasswordIsTypedTwiceAfterItsRule) {
  const std::vector<std::string> init{"lab",  "init", "--laboratory", "Example laboratory", "--administrator",
                                      "N. N."};
  const test::Typed slip = type(init, {"correct horse 7", "correct horse 8"});
  EXPECT_EQ(slip.exit_code, 2) << slip.shown;
  EXPECT_THAT(slip.shown,
              AllOf(HasSubstr("at least 10 characters"), HasSubstr("not the same"), Not(HasSubstr("horse"))));
  EXPECT_FALSE(std::filesystem::exists(folder / "register.db"));
  const test::Typed same = type(init, {"correct horse 7", "correct horse 7"});
  EXPECT_EQ(same.exit_code, 0) << same.shown;
  const test::Typed login = type({"lab", "login", "N. N."}, {"correct horse 7"});
  EXPECT_EQ(login.exit_code, 0) << login.shown;
}

}  // namespace
}  // namespace abcal
