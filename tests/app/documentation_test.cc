// Runs the examples of the documentation, so that they stay correct.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <regex>

#include "tests/app/program_fixtures.h"
#include "tests/support/project_paths.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using Json = nlohmann::json;

/// The blocks of one language in a page, in their order.
std::vector<std::string> code_blocks(const std::string& page, const std::string& language) {
  const std::string text = test::read_file(test::source_folder() / "docs" / page);
  std::vector<std::string> blocks;
  const std::string fence = "```" + language + "\n";
  for (std::size_t at = text.find(fence); at != std::string::npos; at = text.find(fence, at)) {
    at += fence.size();
    blocks.push_back(text.substr(at, text.find("```", at) - at));
  }
  return blocks;
}

class DocumentationTest : public ProgramTest {
 protected:
  /// Debian's own Python, which has the modules that Debian's packages give.
  test::ProgramResult python(const std::string& script) {
    test::write_file(folder / "script.py", script);
    test::Program program("/usr/bin/python3", {"script.py"}, folder.path());
    const int code = program.wait();
    return {code, program.out(), program.err()};
  }
};

TEST_F(DocumentationTest, PythonReadsARunAsThePageShows) {
  const std::vector<std::string> blocks = code_blocks("installing.md", "python");
  ASSERT_GE(blocks.size(), 2U);
  if (python("import sqlite3\n").exit_code != 0) GTEST_SKIP() << "no Python with sqlite3";
  BenchText bench;
  bench.protocol += "closing_angle = true\n";
  write_bench(bench);
  const test::ProgramResult run = abcal({"run", "bench.toml", "-o", "first.run", "--json"});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  const test::ProgramResult plain = python(blocks[0]);
  ASSERT_EQ(plain.exit_code, 0) << plain.err;
  EXPECT_THAT(plain.out, AllOf(HasSubstr("complete g 9.81"), HasSubstr("36 angles"),
                               HasSubstr("10 readings at the first angle")));
  if (python("import numpy\n").exit_code != 0) GTEST_SKIP() << "no Python with numpy";
  const test::ProgramResult fitted = python(
      blocks[0] + blocks[1] + "import json\nprint('JSON' + json.dumps([s.tolist(), offset.tolist()]))\n");
  ASSERT_EQ(fitted.exit_code, 0) << fitted.err;
  const Json numbers = Json::parse(fitted.out.substr(fitted.out.find("JSON") + 4));
  const Json result = Json::parse(abcal({"analyse", "first.run", "--estimator", "abc", "--json"}).out);
  for (std::size_t j = 0; j < 3; ++j) {
    const Json& offset = result["offset"][j];
    // Without weights the fit differs by a part of its type A uncertainty.
    EXPECT_NEAR(numbers[1][j], offset["value"], 3.0 * offset["type_a"].get<double>());
    for (std::size_t k = 0; k < 3; ++k) {
      const Json& s = result["sensitivity_matrix"][j][k];
      EXPECT_NEAR(numbers[0][j][k], s["value"], 3.0 * s["type_a"].get<double>());
    }
  }
}

TEST_F(DocumentationTest, PythonAndCppReadARunFileAsItsPageShows) {
  write_bench({});
  ASSERT_EQ(abcal({"run", "bench.toml", "-o", "sn1234.run"}).exit_code, 0);
  const std::vector<std::string> cpp = code_blocks("run_file.md", "cpp");
  ASSERT_EQ(cpp.size(), 1U);
  test::write_file(folder / "reader.cc", cpp[0]);
  const auto shell = [&](const std::string& command) {
    test::Program program("/bin/sh", {"-c", command}, folder.path());
    const int code = program.wait();
    return test::ProgramResult{code, program.out(), program.err()};
  };
  const test::ProgramResult built = shell("c++ -std=c++20 reader.cc -lsqlite3 -o reader");
  ASSERT_EQ(built.exit_code, 0) << built.err;
  const test::ProgramResult read = shell("./reader sn1234.run");
  ASSERT_EQ(read.exit_code, 0) << read.err;
  EXPECT_EQ(std::count(read.out.begin(), read.out.end(), '\n'), 10) << read.out;
  // The queries for the shell of SQLite.
  const std::string page = test::read_file(test::source_folder() / "docs/run_file.md");
  const std::regex query(
      R"re((sqlite3 (-header -csv )?sn1234.run "[^"\n]*(plan|state|order by k)[^"\n]*"))re");
  int queries = 0;
  for (std::sregex_iterator found(page.begin(), page.end(), query), end; found != end; ++found, ++queries) {
    const test::ProgramResult rows = shell((*found)[1]);
    EXPECT_EQ(rows.exit_code, 0) << rows.err;
    EXPECT_THAT(rows.out, testing::AnyOf(HasSubstr("complete"), HasSubstr(","))) << (*found)[1];
  }
  EXPECT_EQ(queries, 3);
  const std::vector<std::string> blocks = code_blocks("run_file.md", "python");
  ASSERT_EQ(blocks.size(), 1U);
  if (python("import sqlite3\n").exit_code != 0) GTEST_SKIP() << "no Python with sqlite3";
  const test::ProgramResult listed = python(blocks[0]);
  ASSERT_EQ(listed.exit_code, 0) << listed.err;
  EXPECT_EQ(std::count(listed.out.begin(), listed.out.end(), '\n'), 39 + 10 - 3) << listed.out;
}

TEST_F(DocumentationTest, PythonReadsTheHdf5AsThePageShows) {
  const std::vector<std::string> blocks = code_blocks("installing.md", "python");
  ASSERT_EQ(blocks.size(), 3U);
  if (python("import h5py\n").exit_code != 0) GTEST_SKIP() << "no Python with h5py";
  write_bench({});
  const test::ProgramResult run = abcal({"run", "bench.toml", "-o", "first.run", "--json"});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  ASSERT_EQ(abcal({"report", "first.run", "--hdf5", "first.h5"}).exit_code, 0);
  std::string script = blocks[2];
  script.insert(script.find("    print(s[...]"), "    print('JSON', s[...].tolist())\n");
  const test::ProgramResult read = python(script);
  ASSERT_EQ(read.exit_code, 0) << read.err;
  EXPECT_THAT(read.out, AllOf(HasSubstr("g/g_loc"), HasSubstr(" angles, in degree")));
  const std::string line = read.out.substr(read.out.find("JSON") + 4);
  const Json matrix = Json::parse(line.substr(0, line.find('\n')));
  const Json result = Json::parse(abcal({"analyse", "first.run", "--estimator", "abc", "--json"}).out);
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t k = 0; k < 3; ++k) EXPECT_EQ(matrix[j][k], result["sensitivity_matrix"][j][k]["value"]);
  }
}

TEST(ValidationPageTest, EveryTestThatItNamesExists) {
  std::string sources;
  const std::filesystem::path root = test::source_folder();
  for (const auto& entry : std::filesystem::recursive_directory_iterator(root / "tests")) {
    // The contract of the drivers is a header, so that drivers elsewhere are held to it too.
    const std::string file = entry.path().filename().string();
    if (file.ends_with("_test.cc") || file.ends_with("_contract.h")) sources += test::read_file(entry.path());
  }
  // "TEST_F(Suite,\n      Name" and "TEST(Suite, Name" are the same.
  std::erase_if(sources, [](char c) { return c == ' ' || c == '\n'; });
  const std::string page = test::read_file(root / "docs/validation.md");
  const std::regex name("`([A-Z][A-Za-z0-9]+)\\.([A-Z][A-Za-z0-9]+)`");
  int named = 0;
  for (std::sregex_iterator match(page.begin(), page.end(), name), end; match != end; ++match, ++named) {
    const std::string test = "(" + (*match)[1].str() + "," + (*match)[2].str() + ")";
    EXPECT_NE(sources.find(test), std::string::npos) << "docs/validation.md names " << match->str();
  }
  EXPECT_GT(named, 50);
}

}  // namespace
}  // namespace abcal
