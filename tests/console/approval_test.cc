// From result to certificate on the page: who may approve, four eyes, and the same certificate as by command.

#include "app/console/approval.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <string>
#include <vector>

#include "app/console/login_throttle.h"
#include "app/laboratory/certificate/certificate_json.h"
#include "app/laboratory/certificate/issue_certificate.h"
#include "app/laboratory/certificate/signing_certificate.h"
#include "app/system/real_clock.h"
#include "tests/console/console_fixture.h"
#include "tests/console/tray_bench.h"
#include "tests/support/project_paths.h"
#include "tests/support/training_register.h"

namespace abcal::console {
namespace {

using testing::HasSubstr;
using testing::StartsWith;
using Json = nlohmann::json;

/// A run that Operator N. N. has measured, and a console at which Approver N. N. may approve.
class ApprovalTest : public ConsoleTest {
 protected:
  ApprovalTest() {
    registered.log_in("Operator N. N.");
    std::string text = test::read_file(examples / "simulated.toml");
    replace(text, "[operator]\nname = \"Operator N. N.\"\n", "");
    replace(text, "steps = 72\nstep_deg = 5.0", "steps = 12\nstep_deg = 30.0");
    replace(text, "dwell_readings = 1000", "dwell_readings = 50");
    test::write_file(folder / "measured.toml", text);
    std::filesystem::create_directories(runs());
    const auto ran = test::run_program({"run", "measured.toml", "-o", "runs/a.run"}, folder.path());
    EXPECT_EQ(ran.exit_code, 0) << ran.err;
    options.register_location = (folder / "register.db").string();
    options.laboratory_file = examples / "laboratory.toml";
  }
  ~ApprovalTest() override { close(); }

  static void replace(std::string& text, const std::string& what, const std::string& by) {
    const std::size_t at = text.find(what);
    ASSERT_NE(at, std::string::npos) << what;
    text.replace(at, what.size(), by);
  }
  static std::string plus(std::string text) {
    for (char& c : text)
      if (c == ' ') c = '+';
    return text;
  }
  test::Headers logged_in(const std::string& name) {
    const test::Answer answer =
        test::http_post(port, "/login", "name=" + plus(name) + "&password=correct+horse+7");
    EXPECT_EQ(answer.status, 303U) << answer.body;
    const std::string cookie = answer.headers.at("Set-Cookie");
    return {{"Cookie", cookie.substr(0, cookie.find(';'))}};
  }
  Json state() {
    const test::Answer answer = test::http_get(port, path() + "/approval", person);
    EXPECT_EQ(answer.status, 200U) << answer.body;
    return Json::parse(answer.body);
  }
  test::Answer approve(const std::string& name, const std::string& more = "",
                       const std::string& password = "correct horse 7") {
    return test::http_post(port, "/approve",
                           form() + "&name=" + plus(name) + "&password=" + plus(password) + more, person);
  }
  /// Path of the run or its item, also used in a form.
  std::string path() const {
    return "/runs/" + run + (item > 0 ? "/items/" + std::to_string(item) : std::string());
  }
  std::string form() const {
    return "run=" + run + (item > 0 ? "&item=" + std::to_string(item) : std::string()) +
           "&run_sha256=" + sha256;
  }
  void look() {
    person = logged_in("Operator N. N.");
    sha256 = state()["run_sha256"];
  }

  const std::filesystem::path examples = test::source_folder() / "docs/examples";
  test::TrainingRegister registered{folder.path()};
  test::Headers person;
  std::string run = "a.run", sha256;
  int item = 0;  ///< With several items: the item, from 1.
};

TEST_F(ApprovalTest, ASecondPersonApprovesWithTheirPassword) {
  open();
  look();
  EXPECT_EQ(state()["why_not"], "");
  EXPECT_EQ(state()["measured_by"], "Operator N. N.");
  const test::Answer issued = approve("Approver N. N.");
  ASSERT_EQ(issued.status, 200U) << issued.body;
  const std::string number = Json::parse(issued.body)["number"];
  EXPECT_THAT(number, StartsWith("T-"));
  EXPECT_EQ(Json::parse(issued.body)["training"], true);
  EXPECT_TRUE(is_logged("certificate " + number + " of a.run, approved by Approver N. N."));
  // The certificate equals that of the command line.
  const auto kept = current_certificate(runs() / "a.run", 1);
  ASSERT_TRUE(kept);
  EXPECT_EQ(kept->number, number);
  EXPECT_EQ(kept->approved_by, "Approver N. N.");
  EXPECT_EQ(test::http_get(port, "/runs/a.run/certificate.xml", person).body, kept->xml);
  // Page and report cite the certificate: its statements, not those of the analysis.
  const Json stated = Json::parse(certificate_json(kept->xml).dump());
  ASSERT_GT(stated["results"].size(), 5U);
  EXPECT_EQ(Json::parse(test::http_get(port, "/runs/a.run/result", person).body)["certificate"], stated);
  const auto reported = test::run_program({"report", "runs/a.run", "--json"}, folder.path());
  EXPECT_EQ(Json::parse(reported.out)["certificate"], stated) << reported.err;
  const auto verified = test::run_program({"verify", "runs/a.run"}, folder.path());
  EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
  const auto audit = registered.lab({"verify"});
  EXPECT_THAT(audit, HasSubstr("certificate numbers: 1 given"));

  // A double click, or a page that was open before: the form is stale.
  const test::Answer again = approve("Approver N. N.");
  EXPECT_EQ(again.status, 409U) << again.body;
  EXPECT_THAT(again.body, HasSubstr(number));
  const test::Answer amended =
      approve("Approver N. N.", "&replaces=" + number + "&reason=a+wrong+customer&amendment=administrative");
  EXPECT_EQ(amended.status, 200U) << amended.body;
  ASSERT_EQ(state()["certificates"].size(), 2U);
  EXPECT_EQ(state()["certificates"][1]["replaces"], number);
}

TEST_F(ApprovalTest, RefusesWhoMayNot) {
  open();
  look();
  const test::Answer own = approve("Operator N. N.");
  EXPECT_EQ(own.status, 422U);
  EXPECT_THAT(own.body, HasSubstr("may not approve"));
  const test::Answer wrong = approve("Approver N. N.", "", "another horse 7");
  EXPECT_EQ(wrong.status, 422U);
  EXPECT_THAT(wrong.body, HasSubstr("Name or password is not right."));
  sha256 = std::string(64, '0');
  EXPECT_EQ(approve("Approver N. N.").status, 409U);
  EXPECT_EQ(test::http_post(port, "/approve", "run=../a.run&name=a&password=b", person).status, 404U);
  EXPECT_EQ(test::http_post(port, "/approve", "run=a.run", person).status, 400U);
  EXPECT_EQ(test::http_post(port, "/approve", "run=a.run&name=a&password=b").status, 401U) << "nobody";
  test::Headers elsewhere = person;
  elsewhere["Origin"] = "http://evil.example.org";
  EXPECT_EQ(test::http_post(port, "/approve", "run=a.run&name=a&password=b", elsewhere).status, 403U);
  EXPECT_FALSE(current_certificate(runs() / "a.run", 1));
}

TEST_F(ApprovalTest, FourEyes) {
  registered.log_in("Approver N. N.");
  const auto ran = test::run_program({"run", "measured.toml", "-o", "runs/own.run"}, folder.path());
  ASSERT_EQ(ran.exit_code, 0) << ran.err;
  open();
  person = logged_in("Approver N. N.");
  const Json own = Json::parse(test::http_get(port, "/runs/own.run/approval", person).body);
  const test::Answer answer =
      test::http_post(port, "/approve",
                      "run=own.run&run_sha256=" + own["run_sha256"].get<std::string>() +
                          "&name=Approver+N.+N.&password=correct+horse+7",
                      person);
  EXPECT_EQ(answer.status, 422U);
  EXPECT_THAT(answer.body, HasSubstr("Approver N. N. has measured the run"));
}

TEST_F(ApprovalTest, GuessesAtTheSameTimeSlowDownToo) {
  open();
  look();
  std::vector<std::string> forms(18, form() + "&name=Approver+N.+N.&password=another+horse+7");
  forms.push_back(form() + "&name=Approver+N.+N.&password=correct+horse+7");
  const std::vector<unsigned> statuses = test::post_at_once(port, "/approve", forms, person);
  EXPECT_LE(std::ranges::count(statuses, 422U), LoginThrottle::kFree + 1);
  EXPECT_GE(std::ranges::count(statuses, 429U), 13);
  EXPECT_EQ(statuses.back(), 429U) << "the right guess, too";
  EXPECT_FALSE(current_certificate(runs() / "a.run", 1));
}

TEST_F(ApprovalTest, FailuresSlowDown) {
  open();
  look();
  for (int i = 0; i < 5; ++i) EXPECT_EQ(approve("Approver N. N.", "", "wrong").status, 422U);
  EXPECT_EQ(approve("Approver N. N.").status, 429U);
}

/// The private key never reaches the console: it receives only the certificate, signed elsewhere.
class ApprovalByKeyTest : public ApprovalTest {
 protected:
  ApprovalByKeyTest() {
    registered.log_in("Approver N. N.");
    for (const auto& [name, file] : {std::pair{"Approver N. N.", "approver"}, {"Operator N. N.", "operator"}})
      registered.lab({"key", name, "--kind", "person", "-o", in_folder(file, ".pem"), "--certificate",
                      in_folder(file, ".crt")});
  }
  std::string in_folder(const std::string& name, const std::string& ending) const {
    return (folder / (name + ending)).string();
  }
  test::Answer prepare(const std::string& more = "") {
    return test::http_post(port, "/approve", form() + "&by_key=yes" + more, person);
  }
  /// The certificate that is to be signed.
  std::string prepared(const std::string& more = "") {
    const test::Answer answer = prepare(more);
    EXPECT_EQ(answer.status, 200U) << answer.body;
    return answer.status == 200U ? Json::parse(answer.body)["xml"].get<std::string>() : std::string();
  }
  std::string signed_by(const std::string& xml, const std::string& key) {
    test::write_file(folder / "to-sign.xml", xml);
    const auto signing = test::run_program({"lab", "sign", "to-sign.xml", "--sign", key + ".pem",
                                            "--certificate", key + ".crt", "-o", "signed.xml", "--force"},
                                           folder.path());
    EXPECT_EQ(signing.exit_code, 0) << signing.err;
    return test::read_file(folder / "signed.xml");
  }
  test::Answer hand_in(const std::string& xml) {
    return test::http_post(port, path() + "/signed-certificate", xml, person);
  }
  void refuses(const std::string& xml, const std::string& words) {
    const test::Answer answer = hand_in(xml);
    EXPECT_EQ(answer.status, 422U) << words;
    EXPECT_THAT(answer.body, HasSubstr(words));
    EXPECT_FALSE(current_certificate(runs() / "a.run", 1));
  }
  void look_as_approver() {
    person = logged_in("Approver N. N.");
    sha256 = state()["run_sha256"];
  }
};

TEST_F(ApprovalByKeyTest, TheApproverSignsElsewhere) {
  open();
  look_as_approver();
  ASSERT_EQ(state()["keys"].size(), 1U) << "the operator's is not the approver's";
  EXPECT_EQ(hand_in("<xml/>").status, 409U) << "none waits";
  const std::string xml = prepared();
  EXPECT_EQ(prepared(), xml) << "the same number again";
  EXPECT_FALSE(current_certificate(runs() / "a.run", 1)) << "nothing is issued before it is signed";
  const std::string signed_xml = signed_by(xml, "approver");
  const test::Answer issued = hand_in(signed_xml);
  ASSERT_EQ(issued.status, 200U) << issued.body;
  const std::string number = Json::parse(issued.body)["number"];
  EXPECT_TRUE(is_logged("certificate " + number + " of a.run, approved by Approver N. N."));
  const auto kept = current_certificate(runs() / "a.run", 1);
  ASSERT_TRUE(kept);
  EXPECT_EQ(kept->number, number);
  EXPECT_EQ(kept->approved_by, "Approver N. N.");
  EXPECT_EQ(kept->xml, signed_xml);
  const auto verified = test::run_program({"verify", "runs/a.run"}, folder.path());
  EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
  EXPECT_THAT(verified.out, HasSubstr("verifies by a key of Approver N. N."));
  EXPECT_THAT(registered.lab({"verify"}), HasSubstr("certificate numbers: 1 given"));
  EXPECT_EQ(hand_in(signed_xml).status, 409U) << "twice";
  EXPECT_EQ(prepare().status, 409U) << "the form is older than the certificate";

  const std::string amended =
      prepared("&replaces=" + number + "&reason=a+wrong+customer&amendment=administrative");
  EXPECT_EQ(hand_in(signed_by(amended, "approver")).status, 200U);
  EXPECT_EQ(state()["certificates"][1]["replaces"], number);
}

TEST_F(ApprovalByKeyTest, RefusesOtherSignatures) {
  open();
  look_as_approver();
  const std::string xml = prepared(), good = signed_by(xml, "approver");
  refuses(xml, "no signature with an X.509 certificate");
  refuses("no XML", "not the certificate that was to be signed");
  refuses(signed_by(xml, "operator"), "which is none of Approver N. N.'s in the register");
  const auto changed = [&](const std::string& what, const std::string& by) {
    std::string text = good;
    replace(text, what, by);
    return text;
  };
  refuses(changed("Example laboratory", "Another laboratory"), "not the certificate that was to be signed");
  std::string added = xml;
  added.insert(xml.rfind("</"), "<dcc:comment>valid for ten years</dcc:comment>");
  refuses(signed_by(added, "approver"), "not the certificate that was to be signed");
  refuses(changed("xmldsig#enveloped-signature", "xmldsig#base64"), "the signature is of another kind");
  refuses(changed("URI=\"\"", "URI=\"#results\""), "the signature is of another kind");
  const std::size_t value = good.find("SignatureValue>") + std::string("SignatureValue>").size() + 3;
  refuses(changed(good.substr(value, 8), "AAAAAAAA"), "it does not verify");

  // An expired certificate of the key.
  const SigningIdentity old = make_signing_identity("Approver N. N.", "Example laboratory",
                                                    RealClock().utc_now() - std::chrono::hours(24 * 366 * 4));
  test::write_file(folder / "old.pem", old.private_pem);
  test::write_file(folder / "old.crt", old.certificate_pem);
  registered.lab({"key", "Approver N. N.", "--kind", "person", "--certificate", in_folder("old", ".crt")});
  refuses(signed_by(xml, "old"), "required: one that is valid today");

  const Json keys = state()["keys"];
  ASSERT_EQ(keys.size(), 2U);
  for (const Json& key : keys)
    registered.lab({"retire", "key", key["fingerprint"].get<std::string>(), "--reason", "lost"});
  refuses(good, "was retired on");
  EXPECT_EQ(state()["keys"].size(), 0U);
}

TEST_F(ApprovalByKeyTest, RefusesWhoMayNot) {
  open();
  look();  // Viewed by the person who measured.
  const test::Answer own = prepare();
  EXPECT_EQ(own.status, 422U);
  EXPECT_THAT(own.body, HasSubstr("may not approve"));
  EXPECT_EQ(test::http_post(port, "/approve", "run=a.run&by_key=yes").status, 401U) << "nobody";
  look_as_approver();
  const std::string signed_xml = signed_by(prepared(), "approver");
  person = logged_in("Operator N. N.");
  EXPECT_EQ(hand_in(signed_xml).status, 409U) << "it waits for another person";
  test::Headers elsewhere = logged_in("Approver N. N.");
  elsewhere["Origin"] = "http://evil.example.org";
  EXPECT_EQ(test::http_post(port, "/runs/a.run/signed-certificate", signed_xml, elsewhere).status, 403U);
  EXPECT_FALSE(current_certificate(runs() / "a.run", 1));
}

/// A run of three items, of which each has a certificate of its own.
class TrayApprovalTest : public ApprovalByKeyTest {
 protected:
  TrayApprovalTest() {
    registered.log_in("Operator N. N.");
    std::string text = test::small_tray();
    replace(text, "[operator]\nname = \"Operator N. N.\"\n", "");
    test::write_file(folder / "tray.toml", text);
    const auto ran = test::run_program({"run", "tray.toml", "-o", "runs/tray.run"}, folder.path());
    EXPECT_EQ(ran.exit_code, 0) << ran.err;
    run = "tray.run";
  }
  std::string number_of(int k) const {
    const auto kept = current_certificate(runs() / "tray.run", k);
    return kept ? kept->number : "";
  }
};

TEST_F(TrayApprovalTest, EachItemIsApprovedByItself) {
  open();
  item = 2;
  look();
  EXPECT_EQ(state()["why_not"], "");
  const test::Answer issued = approve("Approver N. N.");
  ASSERT_EQ(issued.status, 200U) << issued.body;
  const std::string number = Json::parse(issued.body)["number"];
  EXPECT_TRUE(is_logged("certificate " + number + " of tray.run, item 2, approved by Approver N. N."));
  EXPECT_EQ(number_of(2), number);
  EXPECT_EQ(number_of(1) + number_of(3), "");
  EXPECT_THAT(current_certificate(runs() / "tray.run", 2)->xml, HasSubstr("6284.000002"));
  EXPECT_EQ(approve("Approver N. N.").status, 409U) << "twice";

  // A certificate of another item is independent, and replaces none.
  item = 3;
  EXPECT_EQ(state()["certificates"], Json::array());
  EXPECT_EQ(approve("Approver N. N.", "&replaces=" + number + "&reason=none&amendment=administrative").status,
            409U);
  EXPECT_EQ(approve("Approver N. N.").status, 200U);
  EXPECT_NE(number_of(3), number);
  item = 2;
  EXPECT_EQ(
      approve("Approver N. N.", "&replaces=" + number + "&reason=a+wrong+customer&amendment=administrative")
          .status,
      200U);
  ASSERT_EQ(state()["certificates"].size(), 2U);
  EXPECT_EQ(state()["certificates"][1]["replaces"], number);
  const auto verified = test::run_program({"verify", "runs/tray.run"}, folder.path());
  EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
  EXPECT_THAT(registered.lab({"verify"}), HasSubstr("certificate numbers: 3 given"));
}

TEST_F(TrayApprovalTest, ACertificateWaitsForItsSignatureByItem) {
  open();
  item = 1;
  look_as_approver();
  const std::string first = prepared();
  item = 3;
  const std::string third = prepared();
  EXPECT_THAT(first, HasSubstr("6284.000001"));
  EXPECT_THAT(third, HasSubstr("6284.000003"));
  EXPECT_EQ(hand_in(signed_by(first, "approver")).status, 422U) << "of another item";
  ASSERT_EQ(hand_in(signed_by(third, "approver")).status, 200U);
  EXPECT_EQ(number_of(1), "") << "it waits still";
  item = 1;
  ASSERT_EQ(hand_in(signed_by(first, "approver")).status, 200U);
  EXPECT_EQ(current_certificate(runs() / "tray.run", 1)->approved_by, "Approver N. N.");
  EXPECT_NE(number_of(1), number_of(3));
  item = 2;
  EXPECT_EQ(hand_in("<xml/>").status, 409U) << "none waits";
  const auto verified = test::run_program({"verify", "runs/tray.run"}, folder.path());
  EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
}

TEST_F(TrayApprovalTest, AnItemMustBeNamedAndTakePart) {
  open();
  item = 1;
  look();
  item = 0;
  EXPECT_THAT(state()["why_not"].get<std::string>(), HasSubstr("The run has 3 items"));
  EXPECT_EQ(approve("Approver N. N.").status, 422U);
  item = 4;
  EXPECT_THAT(state()["why_not"].get<std::string>(), HasSubstr("no item 4"));
  EXPECT_EQ(approve("Approver N. N.").status, 422U);
  item = 33;
  EXPECT_EQ(approve("Approver N. N.").status, 404U);
  EXPECT_EQ(test::http_get(port, path() + "/approval", person).status, 404U);
  EXPECT_EQ(number_of(1) + number_of(2) + number_of(3), "");
}

TEST_F(TrayApprovalTest, AnItemThatWasLeftOutHasNoCertificate) {
  test::write_file(folder / "tray.toml",
                   test::read_file(folder / "tray.toml") +
                       "[[fault]]\nkind = \"no-output\"\ninstrument = \"item-3\"\nat_s = 60.0\n");
  const auto ran = test::run_program({"run", "tray.toml", "-o", "runs/short.run"}, folder.path());
  EXPECT_EQ(ran.exit_code, 1) << ran.err;
  open();
  run = "short.run";
  item = 1;
  look();
  EXPECT_EQ(state()["why_not"], "");
  item = 3;
  EXPECT_THAT(state()["why_not"].get<std::string>(), HasSubstr("Item 3 was left out"));
  EXPECT_EQ(approve("Approver N. N.").status, 422U);
}

TEST_F(ApprovalTest, SaysWhyNothingIsIssuedHere) {
  options.laboratory_file.clear();
  open();
  person = logged_in("Operator N. N.");
  EXPECT_THAT(state()["why_not"].get<std::string>(), HasSubstr("--laboratory"));
}

}  // namespace
}  // namespace abcal::console
