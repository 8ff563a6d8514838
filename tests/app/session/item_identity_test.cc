// The instrument that answers is the item of the bench file: at check, start and resume.

#include "app/bench_file/item_identity.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <utility>

#include "app/analysed_run/run_session.h"
#include "app/measure/session/bench_check.h"
#include "app/results/analysis/report_data.h"
#include "drivers/instrument/instrument_error.h"
#include "tests/app/repeatable_run.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

bool agree(const std::string& key, const std::string& stated, const std::string& reported) {
  return IdentityPart{key, key, stated, reported}.agrees();
}

TEST(ItemIdentity, ASerialNumberIsExact) {
  EXPECT_TRUE(agree("serial_number", "6284.123456", "6284.123456"));
  EXPECT_FALSE(agree("serial_number", "SN-OTHER-999", "6284.123456"));
  EXPECT_FALSE(agree("serial_number", "100012345", "0100012345")) << "a leading zero is a digit";
  EXPECT_FALSE(agree("serial_number", "ab", "AB"));
  const ItemIdentityParts trimmed = identity_parts(ItemNames{"", "", " 42 "}, ItemNames{"", "", "42\n"});
  EXPECT_TRUE(trimmed[2].agrees());
}

TEST(ItemIdentity, MakersAndModelsAreComparedByTheirWords) {
  EXPECT_TRUE(agree("maker", "MicroStrain by HBK / LORD", "MicroStrain"));
  EXPECT_TRUE(agree("maker", "LORD MICROSTRAIN", "MicroStrain"));
  EXPECT_TRUE(agree("maker", "Xsens", "Xsens Technologies B.V."));
  EXPECT_FALSE(agree("maker", "Micro", "MicroStrain")) << "a part of a word is another word";
  EXPECT_FALSE(agree("maker", "Analog Devices", "MicroStrain"));
  EXPECT_TRUE(agree("model", "3DM-GV7", "3DM-GV7-AR"));
  EXPECT_TRUE(agree("model", "3dm gv7-ar (6284-9999)", "3DM-GV7-AR"));
  EXPECT_FALSE(agree("model", "ADXL355", "3DM-GV7-AR"));
  EXPECT_FALSE(agree("model", "MTi-3", "MTi-30-2A8G4"));
  EXPECT_FALSE(agree("model", "VN-100", "VN-100T-CR"));
  EXPECT_FALSE(agree("model", "GV7-AR", "3DM-GV7-AR")) << "a model begins with the words of the other";
  EXPECT_FALSE(agree("maker", "-", "MicroStrain")) << "no words agree with nothing";
  EXPECT_TRUE(agree("model", "", "3DM-GV7-AR")) << "what is not stated cannot differ";
}

TEST(ItemIdentity, OnlyWhatAnInstrumentReportsOfTheItemIsCompared) {
  const ItemNames all{"A", "B", "C"};
  const auto reported = [&](const std::string& driver, const std::string& unit) {
    const ItemNames names = reported_by_item(driver, unit, all);
    return names.maker + names.model + names.serial_number;
  };
  EXPECT_EQ(reported("microstrain_mip", "g"), "ABC");
  EXPECT_EQ(reported("vectornav", "m/s2"), "ABC");
  EXPECT_EQ(reported("mavlink", "m/s2"), "C") << "a protocol and a firmware";
  EXPECT_EQ(reported("iio", "m/s2"), "C");
  EXPECT_EQ(reported("witmotion", "g"), "C");
  EXPECT_EQ(reported("text_line", "g"), "C");
  EXPECT_EQ(reported("scpi_voltmeter", "g"), "") << "the voltmeter is not the item, whatever the scale";
  EXPECT_EQ(reported("text_line", "mV"), "");
  EXPECT_EQ(reported("simulated", "g"), "");
}

class ItemOnTheBench : public testing::Test {
 protected:
  /// A bench with an emulated 3DM-GV7-AR of MicroStrain, number 6284.123456, or of another driver.
  static std::string bench(const std::string& item, const std::string& driver = "microstrain_mip") {
    BenchText text = repeatable_bench();
    text.stage_driver = "simulated";
    text.accelerometer_driver = driver;
    text.protocol =
        "steps = 5\nstep_deg = 72.0\nsettle_s = 0.05\ndwell_readings = 10\npoll_interval_s = 0.05\n" +
        text.protocol.substr(text.protocol.find("approach_deg"));
    return text.text() + "[item]\n" + item;
  }
  std::unique_ptr<RunSession> session() {
    RunSession::Options options;
    options.open_bench = [this](const BenchConfig& config, BenchStreams streams) {
      BenchConfig opened = config;
      if (!connected.empty()) opened.items.front().accelerometer_model = connected;
      return make_bench(opened, std::move(streams));
    };
    options.listener = [this](const SessionEvent& event) {
      if (std::holds_alternative<DwellDoneEvent>(event) && ++dwells == stop_after) running->request_stop();
    };
    return std::make_unique<RunSession>(std::move(options));
  }
  StartRequest start(const std::string& toml) {
    return {parse_bench(toml, "bench.toml"), (folder / "a.run").string()};
  }
  /// Why a run does not begin; empty: it was measured.
  std::string refusal(const std::string& toml) {
    try {
      (void)session()->start(start(toml));
    } catch (const InstrumentError& error) {
      EXPECT_EQ(error.fault(), Fault::kWrongIdentity);
      return error.what();
    }
    return "";
  }
  ReportData measured(const std::string& toml) {
    (void)session()->start(start(toml));
    return gather_report(folder / "a.run", {});
  }

  test::TemporaryFolder folder;
  std::string connected;  ///< Model of the emulated instrument; empty: the usual one.
  RunSession* running = nullptr;
  int dwells = 0, stop_after = 0;
};

// Version 1.0 measured this item, and certified it as the one that [item] names.
TEST_F(ItemOnTheBench, AnotherItemThanTheOneThatAnswersIsRefusedAtTheStart) {
  const std::string why =
      refusal(bench("maker = \"Analog Devices\"\nmodel = \"ADXL355\"\nserial_number = \"SN-OTHER-999\"\n"));
  EXPECT_THAT(
      why,
      AllOf(HasSubstr("maker is \"MicroStrain\" as the instrument reports it; required: \"Analog Devices\""),
            HasSubstr("model is \"3DM-GV7-AR\""), HasSubstr("required: \"ADXL355\""),
            HasSubstr("serial number is \"6284.123456\""), HasSubstr("required: \"SN-OTHER-999\"")));
  EXPECT_THAT(why,
              HasSubstr("write serial_number = \"6284.123456\" if the instrument that answers is the item"));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.run"));
  EXPECT_THAT(refusal(bench("serial_number = \"6284.123457\"\n")), HasSubstr("6284.123457"));
}

TEST_F(ItemOnTheBench, WhatTheBenchFileLeavesOpenIsRead) {
  const ReportData data = measured(bench("maker = \"MicroStrain by HBK\"\n"));
  EXPECT_EQ(data.label("item.maker"), "MicroStrain by HBK");
  EXPECT_EQ(data.label("item.model"), "3DM-GV7-AR");
  EXPECT_EQ(data.label("item.serial_number"), "6284.123456");
  for (const IdentityPart& part : identity_of(data)) EXPECT_EQ(part.known_by(), KnownBy::kRead) << part.key;
  EXPECT_EQ(describe_sources(identity_of(data)), "maker, model and serial number read from the instrument");
}

TEST_F(ItemOnTheBench, WhatAnInstrumentDoesNotReportIsStatedNotRead) {
  const std::string stated = "maker = \"Maker\"\nmodel = \"M-3\"\nserial_number = \"SN-42\"\n";
  for (const std::string driver : {"simulated", "text_line"}) {
    std::string toml = bench(stated, driver);
    toml.insert(toml.find("rate_hz"), "response_unit = \"g\"\n");
    const ReportData data = measured(toml);
    for (const IdentityPart& part : identity_of(data))
      EXPECT_EQ(part.known_by(), KnownBy::kStated) << driver << " " << part.key;
    EXPECT_EQ(describe_sources(identity_of(data)), "maker, model and serial number stated, not read");
    std::filesystem::remove(folder / "a.run");
    std::filesystem::remove(folder / "a.run.results");
  }
}

TEST_F(ItemOnTheBench, AVoltmeterIsNotTheItem) {
  std::string toml = bench("maker = \"Maker\"\n", "scpi_voltmeter");
  toml.replace(toml.find("rate_hz = 200.0"), 15, "rate_hz = 2.0\nresponse_unit = \"V\"");
  const ReportData data = measured(toml);
  EXPECT_EQ(data.label("item.maker"), "Maker");
  EXPECT_EQ(data.label("item.model"), "") << "that of the voltmeter is none of the item";
  EXPECT_EQ(data.run->header.items.front().model, "");
  EXPECT_EQ(describe_sources(identity_of(data)), "maker stated, not read");
}

TEST_F(ItemOnTheBench, ARunGoesOnOnlyWithItsItem) {
  const std::string toml = bench("model = \"3DM-GV7-AR\"\n");
  const std::unique_ptr<RunSession> first = session();
  running = first.get();
  stop_after = 4;
  EXPECT_THROW((void)first->start(start(toml)), std::exception);
  stop_after = 0;
  // Another model with the same serial number.
  connected = "3DM-GX5-AHRS";
  try {
    (void)session()->resume({(folder / "a.run").string()});
    ADD_FAILURE() << "another item was measured to the end";
  } catch (const InstrumentError& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("model is \"3DM-GX5-AHRS\""), HasSubstr("required: \"3DM-GV7-AR\"")));
  }
  connected.clear();
  EXPECT_EQ(session()->resume({(folder / "a.run").string()}).stored().state, RunState::kComplete);
}

TEST_F(ItemOnTheBench, EachOfSeveralItemsIsComparedWithItsOwn) {
  std::string toml = bench("");
  const std::size_t begin = toml.find("[accelerometer]"), end = toml.find("[protocol]");
  const std::string accelerometer = "[item.accelerometer]" + toml.substr(begin + 15, end - begin - 15);
  toml.erase(begin, end - begin);
  toml.erase(toml.find("[item]\n"));
  const auto item = [&](const std::string& stated, const std::string& reported) {
    return "[[item]]\nserial_number = \"" + stated + "\"\n" + accelerometer + "serial_number = \"" +
           reported + "\"\n";
  };
  EXPECT_EQ(refusal(toml + item("1", "1") + item("2", "2")), "");
  std::filesystem::remove(folder / "a.run");
  EXPECT_THAT(refusal(toml + item("1", "1") + item("2", "3")),
              AllOf(HasSubstr("item 2, accelerometer"), HasSubstr("serial number is \"3\""),
                    Not(HasSubstr("item 1"))));
}

TEST_F(ItemOnTheBench, TheCheckComparesIt) {
  const auto findings = [&](const std::string& toml) {
    const BenchConfig config = parse_bench(toml, "bench.toml");
    Bench opened = make_bench(config);
    return check_bench(opened, config, {true, {}, {}});
  };
  const auto of_item = [](const std::vector<Finding>& all) {
    for (const Finding& finding : all)
      if (finding.what == kItemFinding.english()) return finding;
    return Finding{};
  };
  const Finding good = of_item(findings(bench("model = \"3DM-GV7\"\n")));
  EXPECT_EQ(good.grade, Finding::Grade::kGood);
  EXPECT_THAT(good.found, HasSubstr("read from the instrument"));
  const Finding other = of_item(findings(bench("model = \"ADXL355\"\n")));
  EXPECT_EQ(other.grade, Finding::Grade::kProblem);
  EXPECT_THAT(other.found, HasSubstr("model is \"3DM-GV7-AR\""));
  EXPECT_THAT(of_item(findings(bench("model = \"M-3\"\n", "simulated"))).found,
              HasSubstr("stated, not read"));
}

}  // namespace
}  // namespace abcal
