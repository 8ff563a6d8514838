// Comparisons of laboratories on the console: their state without any value, then who agrees.

#include "app/console/comparisons.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstddef>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "protocol/quantities/output_names.h"
#include "protocol/record/sha256.h"
#include "tests/console/console_fixture.h"

namespace abcal::console {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using Json = nlohmann::json;

/// A comparison of three in the folder of the runs; every value begins with the digits 0.7391.
class ComparisonsTest : public ConsoleTest {
 protected:
  ComparisonsTest() {
    std::filesystem::create_directories(runs());
    std::string text =
        "schema = \"abcal.comparison/1\"\n[comparison]\nname = \"Comparison of three\"\npilot = \"LAB1\"\n"
        "item_serial_number = \"17\"\nresponse_unit = \"V\"\ndraws = 1000\n";
    for (const char* name : {"LAB1", "LAB2", "LAB3"}) {
      text += std::string("[[participant]]\nname = \"") + name + "\"\n[[measurement]]\nparticipant = \"" +
              name + "\"\ndate = 2026-02-02\n";
      std::string table =
          "# response_unit: V\n# item_serial_number: 17\n"
          "quantity,value,s_u,s_v,s_w,phi_uv,phi_vw,phi_wu,O_u,O_v,O_w\n";
      for (std::size_t i = 0; i < kIntrinsicSymbols.size(); ++i) {
        table += std::string(kIntrinsicSymbols[i]) + ",0.7391" + name[3];
        for (std::size_t k = 0; k < kIntrinsicSymbols.size(); ++k) table += i == k ? ",1e-8" : ",0";
        table += "\n";
      }
      test::write_file(runs() / (std::string(name) + ".csv"), table);
    }
    test::write_file(runs() / "c.toml", text);
    test::write_file(runs() / "bench.toml", "[bench]\nname = \"no protocol\"\n");
  }
  void pilot_add(std::vector<std::string> words) {
    words.insert(words.begin(), {"pilot", "add", "runs/c.toml"});
    const auto added = test::run_program(words, folder.path());
    ASSERT_EQ(added.exit_code, 0) << added.err;
  }
  void add(const std::string& name) { pilot_add({"runs/" + name + ".csv", "--participant", name}); }
  std::string get(const std::string& path) { return test::http_get(port, path).body; }
  Json list() { return Json::parse(get("/comparisons")); }
};

TEST_F(ComparisonsTest, StateIsThatOfTheCommandAndShowsNoValue) {
  add("LAB1");
  pilot_add({"--participant", "LAB2", "--sha256", sha256_of_file(runs() / "LAB2.csv")});
  open();
  const std::string all = get("/comparisons");
  const Json comparisons = Json::parse(all);
  ASSERT_EQ(comparisons.size(), 1U) << "the bench file is no protocol";
  Json state = comparisons[0];
  EXPECT_EQ(state["file"], "c.toml");
  state.erase("file");
  const auto said = test::run_program({"pilot", "status", "runs/c.toml", "--json"}, folder.path());
  EXPECT_EQ(state, Json::parse(said.out));
  EXPECT_EQ(state["measurements"][0]["state"], "in");
  EXPECT_EQ(state["measurements"][1]["state"], "committed");
  EXPECT_EQ(state["measurements"][2]["state"], "open");
  const test::Answer outcome = test::http_get(port, "/comparisons/c.toml/outcome");
  EXPECT_EQ(outcome.status, 422U);
  EXPECT_THAT(outcome.body, AllOf(HasSubstr("no value is shown before all results are in"),
                                  HasSubstr("measurement 3 by LAB3")));
  const test::Answer draft = test::http_get(port, "/comparisons/c.toml/draft_a.html");
  EXPECT_EQ(draft.status, 422U);
  for (const std::string& answer : {all, outcome.body, draft.body})
    EXPECT_THAT(answer, Not(HasSubstr("7391")));
}

TEST_F(ComparisonsTest, CommittedResultsWithoutTheirFilesShowNoValue) {
  add("LAB1");
  for (const char* name : {"LAB2", "LAB3"})
    pilot_add({"--participant", name, "--sha256", sha256_of_file(runs() / (std::string(name) + ".csv"))});
  open();
  EXPECT_EQ(list()[0]["complete"], true);
  const test::Answer outcome = test::http_get(port, "/comparisons/c.toml/outcome");
  EXPECT_EQ(outcome.status, 422U);
  EXPECT_THAT(outcome.body, AllOf(HasSubstr("its file was not added"), Not(HasSubstr("7391"))));
}

TEST_F(ComparisonsTest, OutcomeAndDraftAreThoseOfTheCommand) {
  for (const char* name : {"LAB1", "LAB2", "LAB3"}) add(name);
  open();
  const Json outcome = Json::parse(get("/comparisons/c.toml/outcome"));
  const Json analysed =
      Json::parse(test::run_program({"pilot", "analyse", "runs/c.toml", "--json"}, folder.path()).out);
  EXPECT_EQ(outcome["verdict"], analysed["verdict"]);
  EXPECT_EQ(outcome["agree"], analysed["agree"]);
  EXPECT_EQ(outcome["messages"][0]["id"], "The participants agree within their uncertainties.");
  const test::Answer draft = test::http_get(port, "/comparisons/c.toml/draft_a.html");
  EXPECT_THAT(draft.body, AllOf(HasSubstr("Draft A: Comparison of three"), HasSubstr("0.7391")));
  EXPECT_EQ(draft.headers.at("Content-Disposition"), "attachment");
}

TEST_F(ComparisonsTest, OtherNamesLeadNowhereAndABrokenProtocolIsListedWithTheReason) {
  test::write_file(folder / "secret.toml", test::read_file(runs() / "c.toml"));
  test::write_file(runs() / "broken.toml", "schema = \"abcal.comparison/1\"\n[comparison]\nname = 3\n");
  open();
  EXPECT_EQ(test::http_get(port, "/comparisons/secret.toml/outcome").status, 404U);
  EXPECT_EQ(test::http_get(port, "/comparisons/..%2Fsecret.toml/outcome").status, 404U);
  EXPECT_EQ(test::http_get(port, "/comparisons/bench.toml/outcome").status, 404U);
  EXPECT_EQ(test::http_get(port, "/comparisons/c.toml/values").status, 404U);
  const Json comparisons = list();
  ASSERT_EQ(comparisons.size(), 2U);
  EXPECT_EQ(comparisons[0]["file"], "broken.toml");
  EXPECT_THAT(comparisons[0]["error"].get<std::string>(), HasSubstr("item_serial_number"));
}

}  // namespace
}  // namespace abcal::console
