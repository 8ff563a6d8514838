// Files given by mistake where a run is expected.
#include "app/results/analysis/other_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include "app/results/analysis/load_record.h"
#include "app/results/analysis/recompute.h"
#include "protocol/record/import_table.h"
#include "tests/support/program.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class OtherFileTest : public testing::Test {
 protected:
  std::filesystem::path file(const std::string& name, const std::string& text) {
    const std::filesystem::path path = folder.path() / name;
    std::ofstream(path, std::ios::binary) << text;
    return path;
  }
  static std::string words(const auto& read) {
    try {
      read();
    } catch (const std::exception& error) {
      return error.what();
    }
    return "read without a word";
  }
  static std::string loaded(const std::filesystem::path& path) {
    return words([&] { load_record(path); });
  }
  test::TemporaryFolder folder;
};

TEST_F(OtherFileTest, ABenchFileIsCalledOneWhateverItsName) {
  const std::string bench = test::read_file(test::source_folder() / "docs/examples/simulated.toml");
  for (const char* name : {"bench.toml", "bench.txt"}) {
    const std::filesystem::path path = file(name, bench);
    EXPECT_EQ(loaded(path), path.string() +
                                ": is a bench file; required: a run file (.run) or a table of readings. "
                                "`abcal run " +
                                path.string() + "` measures a run");
    EXPECT_THAT(words([&] { verify_and_recompute(path); }),
                HasSubstr("is a bench file; required: a run file (.run). `abcal run "));
  }
}

TEST_F(OtherFileTest, XmlJsonAndOtherTomlAreCalledWhatTheyAre) {
  EXPECT_THAT(
      loaded(file("certificate.xml", "\xef\xbb\xbf\n<?xml version=\"1.0\"?><a/>")),
      AllOf(HasSubstr("is XML, such as a certificate; required: a run file"), HasSubstr("abcal compare")));
  EXPECT_THAT(loaded(file("result.json", "{\"schema\": \"abcal.result/1\"}")),
              HasSubstr("is JSON; required: a run file"));
  EXPECT_THAT(loaded(file("laboratory.txt", "[laboratory]\nname = \"L\"\n")),
              HasSubstr("is a TOML file; required"));
  EXPECT_THAT(loaded(file("broken.toml", "[bench\n")), HasSubstr("is a TOML file; required"));
}

TEST_F(OtherFileTest, ACsvIsReadOrRefusedAsOne) {
  for (const char* text :
       {"", "experiment,n\n1,1\n", "# g_loc_mps2 = 9.81\nexperiment,n\n1,1\n", "# a = 1\n", "a=b,c\n"})
    EXPECT_THROW(load_record(file("readings.csv", text)), TableError) << text;
  EXPECT_THAT(words([&] { verify_and_recompute(folder.path() / "absent.toml"); }), HasSubstr("no such file"));
}

}  // namespace
}  // namespace abcal
