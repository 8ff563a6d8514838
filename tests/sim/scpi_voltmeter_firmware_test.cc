#include "sim/firmware/scpi_voltmeter_firmware.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "tests/sim/firmware_host.h"

namespace abcal::sim {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::HasSubstr;
using testing::StartsWith;

/// Reads 1 V/g_loc, 2 V/g_loc and 3 V/g_loc along its axes, and offsets: at rest (0.5, -0.25, 3.125) V.
BenchTruth truth_in_volts() {
  BenchTruth truth;
  truth.sensitivity_matrix.diagonal() << 1.0, 2.0, 3.0;
  truth.offset << 0.5, -0.25, 0.125;
  return truth;
}

class ScpiTest : public testing::Test {
 protected:
  explicit ScpiTest(ScpiVoltmeterSettings settings = {}, BenchTruth truth = truth_in_volts())
      : bench(std::make_shared<SimBench>(std::move(truth))),
        firmware(bench, std::move(settings)),
        host(firmware) {}

  std::string ask(std::string_view query, Clock::Duration wait = milliseconds(1)) {
    host.send(std::string(query) + "\n");
    return host.listen(wait);
  }
  /// Sends a set command, which has no reply, and queries its error.
  std::string command(std::string_view text) {
    EXPECT_EQ(ask(text), "") << text;
    return ask("SYST:ERR?");
  }

  std::shared_ptr<SimBench> bench;
  ScpiVoltmeterFirmware firmware;
  FirmwareHost host;
};

class Keysight34970aTest : public ScpiTest {};

constexpr std::string_view kNoError = "+0,\"No error\"\n";

TEST_F(Keysight34970aTest, SaysWhatItIs) {
  EXPECT_EQ(ask("*IDN?"), "HEWLETT-PACKARD,34970A,MY44012345,13-2-2\n");
  EXPECT_THAT(ask("SYST:CTYP? 100"), HasSubstr("34901A"));
  EXPECT_EQ(ask("SYST:CTYP? 200"), "HEWLETT-PACKARD,0,0,0\n");
  EXPECT_EQ(ask("SYSTEM:ERROR?"), kNoError);
}

TEST_F(Keysight34970aTest, ScansItsChannelsInTheOrderOfTheList) {
  EXPECT_EQ(command("*RST"), kNoError);
  EXPECT_EQ(command("*CLS"), kNoError);
  EXPECT_EQ(command("CONF:VOLT:DC 10,MAX,(@101,102,103)"), kNoError);
  EXPECT_EQ(command("SENS:VOLT:DC:NPLC 1,(@101:103)"), kNoError);
  EXPECT_EQ(command("SENS:VOLT:DC:ZERO:AUTO ON,(@101:103)"), kNoError);
  EXPECT_EQ(command("ROUT:SCAN (@101:103)"), kNoError);
  EXPECT_EQ(command("TRIG:SOUR IMM"), kNoError);
  EXPECT_EQ(command("TRIG:COUN 1"), kNoError);
  EXPECT_EQ(command("FORM:READ:CHAN OFF"), kNoError);
  EXPECT_EQ(ask("ROUT:SCAN?"), "#214(@101,102,103)\n");
  EXPECT_EQ(ask("READ?", seconds(1)), "+5.00000000E-01,-2.50000000E-01,+3.12500000E+00\n");
  EXPECT_EQ(command("rout:scan (@103,101)"), kNoError);
  EXPECT_EQ(ask("READ?", seconds(1)), "+3.12500000E+00,+5.00000000E-01\n");
  EXPECT_EQ(command("FORM:READ:CHAN ON;UNIT ON"), kNoError);
  EXPECT_EQ(ask("READ?", seconds(1)), "+3.12500000E+00 VDC,103,+5.00000000E-01 VDC,101\n");
  EXPECT_EQ(command("ROUTe:SCAN (@105)"), kNoError);
  EXPECT_EQ(ask("READ?", seconds(1)), "+0.00000000E+00 VDC,105\n") << "nothing is connected there";
}

TEST_F(Keysight34970aTest, MeasuresForAsLongAsItIntegrates) {
  command("CONF:VOLT:DC 10,DEF,(@101,102,103)");
  command("SENS:VOLT:DC:NPLC 10,(@101:103)");
  // Three times (twice 10 cycles of 20 ms, and 4 ms).
  EXPECT_EQ(ask("READ?", milliseconds(1211)), "");
  EXPECT_THAT(host.listen(milliseconds(2)), StartsWith("+5.0"));
  command("SENS:VOLT:DC:NPLC 0.02,(@101:103)");
  command("SENS:VOLT:DC:ZERO:AUTO OFF,(@101:103)");
  EXPECT_THAT(ask("READ?", milliseconds(15)), StartsWith("+5.0"));  // three times 4.4 ms
}

TEST_F(Keysight34970aTest, MeasuresInTheBackgroundAfterInit) {
  command("CONF:VOLT:DC 10,DEF,(@101:103)");
  EXPECT_EQ(ask("FETC?"), "");
  EXPECT_EQ(ask("SYST:ERR?"), "-230,\"Data stale\"\n");
  host.send("INIT\n");
  EXPECT_THAT(ask("*IDN?"), HasSubstr("34970A")) << "it listens meanwhile";
  EXPECT_EQ(command("INIT"), "-213,\"Init ignored\"\n");
  EXPECT_EQ(ask("*OPC?;*IDN?", milliseconds(10)), "");
  EXPECT_THAT(host.listen(milliseconds(200)), StartsWith("1;HEWLETT"));
  EXPECT_EQ(ask("FETC?"), "+5.00000000E-01,-2.50000000E-01,+3.12500000E+00\n");
  ask("INIT");
  EXPECT_EQ(ask("FETC?", milliseconds(50)), "");
  EXPECT_THAT(host.listen(milliseconds(200)), StartsWith("+5.0")) << "waits for the end";
}

TEST_F(Keysight34970aTest, KeepsCommandsThatComeWhileItMeasures) {
  command("CONF:VOLT:DC 10,DEF,(@101)");
  EXPECT_EQ(ask("READ?\nSYST:ERR?\n*IDN?", milliseconds(10)), "");
  EXPECT_EQ(host.listen(seconds(1)),
            "+5.00000000E-01\n" + std::string(kNoError) + "HEWLETT-PACKARD,34970A,MY44012345,13-2-2\n");
  ask("READ?");
  EXPECT_EQ(ask("\x03*IDN?"), "HEWLETT-PACKARD,34970A,MY44012345,13-2-2\n") << "device clear";
}

TEST_F(Keysight34970aTest, AcceptsTheStylesOfDifferentHosts) {
  for (const char* text :
       {"CONFigure:VOLTage:DC AUTO,AUTO,(@101,102,103)", ":conf:volt:dc 10, max, (@101:103)",
        "CONF:VOLT 10,1E-5,(@101:103)\r", "CONF:VOLT:DC (@101:103)",
        "SENS:VOLT:DC:NPLC 1,(@101:103);ZERO:AUTO ON,(@101:103)",
        "SENS:VOLT:DC:RANG 10,(@101);:ROUT:SCAN (@101)"})
    EXPECT_EQ(command(text), kNoError) << text;
}

TEST_F(Keysight34970aTest, RefusesWithTheErrorsOfScpi) {
  EXPECT_EQ(command("HELLO"), "-113,\"Undefined header\"\n");
  EXPECT_EQ(command("CONF:VOLT:AC 10,MAX,(@101)"), "-113,\"Undefined header\"\n");
  EXPECT_EQ(command("CONFI:VOLT:DC 10,MAX,(@101)"), "-113,\"Undefined header\"\n")
      << "neither short nor long";
  EXPECT_EQ(command("CONF:VOLT:DC 10"), "-109,\"Missing parameter\"\n");
  EXPECT_EQ(command("ROUT:SCAN"), "-109,\"Missing parameter\"\n");
  EXPECT_EQ(command("CONF:VOLT:DC 1000,MAX,(@101)"), "-222,\"Data out of range\"\n");
  EXPECT_EQ(command("ROUT:SCAN (@1)"), "-222,\"Data out of range\"\n");
  EXPECT_EQ(command("ROUT:SCAN 101"), "-224,\"Illegal parameter value\"\n");
  EXPECT_EQ(command("TRIG:SOUR EXT"), "-224,\"Illegal parameter value\"\n");
  EXPECT_EQ(command("CONF:VOLT:DC 10V,MAX,(@101)"), "-131,\"Invalid suffix\"\n");
  EXPECT_EQ(command("READ?"), "-213,\"Init ignored\"\n") << "no scan list";
  for (int n = 0; n < 25; ++n) ask("HELLO");
  for (int n = 0; n < 19; ++n) EXPECT_EQ(ask("SYST:ERR?"), "-113,\"Undefined header\"\n");
  EXPECT_EQ(ask("SYST:ERR?"), "-350,\"Queue overflow\"\n");
  EXPECT_EQ(ask("SYST:ERR?"), kNoError);
}

TEST_F(Keysight34970aTest, SaysOverload) {
  command("CONF:VOLT:DC 1,MAX,(@101:103)");
  EXPECT_EQ(ask("READ?", seconds(1)), "+5.00000000E-01,-2.50000000E-01,+9.90000000E+37\n");
  command("CONF:VOLT:DC AUTO,MAX,(@101:103)");
  EXPECT_THAT(ask("READ?", seconds(1)), HasSubstr("+3.125"));
}

TEST_F(Keysight34970aTest, FollowsTheStage) {
  command("CONF:VOLT:DC 10,MAX,(@101:103)");
  bench->move(StageAxis::kX, Angle::degrees(180), host.clock().now());
  host.listen(seconds(20));
  EXPECT_THAT(ask("READ?", seconds(1)), HasSubstr("-2.87500000E+00"));  // -3 + 0.125
}

TEST_F(Keysight34970aTest, SaysNothingWhileTheWorldGivesNoOutput) {
  command("CONF:VOLT:DC 10,MAX,(@101:103)");
  const Clock::Instant now = host.clock().now();
  bench->inject({.kind = FaultKind::kNoOutput, .at = now, .until = now + seconds(60)});
  EXPECT_EQ(ask("READ?", seconds(59)), "");
  EXPECT_THAT(host.listen(seconds(2)), StartsWith("+5.0"));
}

class OldKeysightTest : public ScpiTest {
 protected:
  OldKeysightTest() : ScpiTest({.accepts_second_auto = false}) {}
};

TEST_F(OldKeysightTest, MayRefuseASecondAuto) {
  EXPECT_EQ(command("CONF:VOLT:DC AUTO,AUTO,(@101)"), "-224,\"Illegal parameter value\"\n");
  EXPECT_EQ(command("CONF:VOLT:DC AUTO,DEF,(@101)"), kNoError);
}

class Keysight34401aTest : public ScpiTest {
 protected:
  Keysight34401aTest()
      : ScpiTest({.family = ScpiFamily::kKeysight34401a, .single_channel = 2, .needs_remote = true}) {}
};

TEST_F(Keysight34401aTest, MeasuresItsOneChannel) {
  EXPECT_EQ(command("CONF:VOLT:DC 10,0.00001"), "+550,\"Command not allowed in local\"\n");
  EXPECT_EQ(command("SYST:REM"), kNoError);
  EXPECT_EQ(command("CONF:VOLT:DC 10,0.00001"), kNoError);
  EXPECT_EQ(ask("CONF?"), "\"VOLT +1.000000E+01,+1.000000E-05\"\n");
  EXPECT_EQ(ask("READ?", seconds(5)), "+3.12500000E+00\n");
  EXPECT_EQ(command("SAMP:COUN 3"), kNoError);
  EXPECT_EQ(ask("READ?", seconds(5)), "+3.12500000E+00,+3.12500000E+00,+3.12500000E+00\n");
  EXPECT_EQ(command("CONF:VOLT:DC 10,MAX,(@101)"), "-108,\"Parameter not allowed\"\n");
  EXPECT_EQ(command("ROUT:SCAN (@101)"), "-113,\"Undefined header\"\n");
}

// The queries of pymeasure's HP34401A on direct voltage.
TEST_F(Keysight34401aTest, ItsSettingsAreReadBack) {
  EXPECT_EQ(ask("TRIG:DEL?"), "+0.00000000E+00\n");
  EXPECT_EQ(command("TRIG:DEL 0.5"), kNoError);
  EXPECT_EQ(ask("TRIG:DEL?"), "+5.00000000E-01\n");
  EXPECT_EQ(command("VOLT:RANG 10;NPLC 10"), kNoError);
  EXPECT_EQ(ask("VOLT:RES?"), "+1.00000000E-05\n");
  EXPECT_EQ(ask("ROUT:TERM?"), "FRON\n");
  EXPECT_EQ(ask("DISP?"), "1\n");
  EXPECT_EQ(command("DISP OFF"), kNoError);
  EXPECT_EQ(ask("DISP?"), "0\n");
  EXPECT_EQ(command("DISP:TEXT \"HELLO\""), kNoError);
  EXPECT_EQ(ask("DISP:TEXT?"), "\"HELLO\"\n");
  EXPECT_EQ(command("DISP:TEXT:CLE"), kNoError);
  EXPECT_EQ(ask("DISP:TEXT?"), "\"\"\n");
  EXPECT_EQ(command("INP:IMP:AUTO 1"), kNoError);
  EXPECT_EQ(ask("INP:IMP:AUTO?"), "1\n");
  EXPECT_EQ(command("DET:BAND 200"), kNoError);
  EXPECT_EQ(ask("DET:BAND?"), "+2.00000000E+02\n");
  EXPECT_EQ(ask("SYST:BEEP:STAT?"), "1\n");
  EXPECT_EQ(ask("TRIG:DEL:AUTO?"), "1\n");
  EXPECT_EQ(command("*RST"), kNoError);
  EXPECT_EQ(ask("DISP?"), "1\n");
  EXPECT_TRUE(firmware.unserved().all().empty());
}

TEST_F(Keysight34401aTest, AFunctionThatItDoesNotSimulateIsListed) {
  EXPECT_THAT(command("FUNC \"FREQ\""), HasSubstr("-224"));
  EXPECT_THAT(command("DISP MAYBE"), HasSubstr("-224")) << "refused, yet known";
  ASSERT_EQ(firmware.unserved().all().size(), 1U);
  EXPECT_EQ(firmware.unserved().all()[0].command, "FUNC FREQ");
}

class Keithley2700Test : public ScpiTest {
 protected:
  Keithley2700Test() : ScpiTest({.family = ScpiFamily::kKeithley2700}) {}
};

TEST_F(Keithley2700Test, ScansWithItsOwnCommandsAndElements) {
  constexpr std::string_view kNone = "0, \"no error\"\n";
  EXPECT_EQ(ask("*IDN?"), "KEITHLEY INSTRUMENTS INC.,MODEL 2700,MY44012345,B09  /A02  \n");
  EXPECT_EQ(command(":SENS:FUNC \"VOLT\""), kNone);
  EXPECT_EQ(command(":FORM:ELEM READ,CHAN,UNIT"), kNone);
  EXPECT_EQ(ask(":READ?", seconds(1)), "+5.00000000E-01VDC,000\n") << "the front input";
  EXPECT_EQ(command(":ROUT:SCAN (@101:103)"), kNone);
  EXPECT_EQ(command(":ROUT:SCAN:LSEL INT"), kNone);
  EXPECT_EQ(command(":TRIG:COUN 1"), kNone);
  EXPECT_EQ(command(":SAMP:COUN 3"), kNone);
  EXPECT_EQ(ask(":READ?", seconds(1)),
            "+5.00000000E-01VDC,101,-2.50000000E-01VDC,102,+3.12500000E+00VDC,103\n");
  EXPECT_EQ(command(":FORM:ELEM READ"), kNone);
  EXPECT_EQ(ask(":READ?", seconds(1)), "+5.00000000E-01,-2.50000000E-01,+3.12500000E+00\n");
  EXPECT_EQ(command(":FORM:ELEM COLOUR"), "-224,\"Illegal parameter value\"\n");
  EXPECT_EQ(command(":INIT:CONT ON"), kNone);
  EXPECT_EQ(command(":READ?"), "-213,\"Init ignored\"\n");
}

TEST_F(Keithley2700Test, TakesTheLinesOfItsHosts) {
  constexpr std::string_view kNone = "0, \"no error\"\n";
  EXPECT_EQ(command("status:queue:clear;*RST;:stat:pres;:*CLS;"), kNone);
  EXPECT_EQ(ask("*OPC?"), "1\n");
  EXPECT_EQ(ask("SYST:ERR:NEXT?"), kNone);
  EXPECT_EQ(command(":SENS:FUNC 'VOLT:DC'"), kNone);
  EXPECT_EQ(command("ROUTe:MULTiple:CLOSe (@102)"), kNone);
  EXPECT_EQ(command(":FORM:ELEM READ"), kNone);
  EXPECT_EQ(ask(":READ?", seconds(1)), "-2.50000000E-01\n") << "the channel that is closed";
  EXPECT_EQ(command(":ROUTe:OPEN:ALL"), kNone);
  EXPECT_EQ(ask("*OPT?"), "7700,NONE\n");
  EXPECT_EQ(command("SYST:BEEP 500, 0.1"), kNone);
}

// The queries of pymeasure's Keithley2000 and Keithley2700 on direct voltage.
TEST_F(Keithley2700Test, ItsSettingsAreReadBack) {
  EXPECT_EQ(ask(":CONF?"), "\"VOLT:DC\"\n");
  EXPECT_EQ(ask(":SENS:VOLT:DIG?"), "7\n");
  EXPECT_EQ(ask(":SENS:VOLT:DIG 5;DIG?"), "5\n");
  EXPECT_EQ(ask(":SENS:VOLT:REF 0.5;REF?"), "+5.00000000E-01\n");
  EXPECT_EQ(ask(":TRIG:SEQ:DEL 2;DEL?"), "+2.00000000E+00\n");
  EXPECT_EQ(ask("ROUT:MULT:CLOS?"), "(@)\n");
  EXPECT_EQ(ask("ROUT:MULT:CLOS (@102);CLOS?"), "(@102)\n");
  EXPECT_EQ(ask("ROUT:MULT:STAT? (@101,102)"), "0,1\n");
  EXPECT_EQ(ask("ROUT:MULT:OPEN (@102);CLOS?"), "(@)\n");
  EXPECT_EQ(ask("DISP:TEXT:STAT?"), "0\n");
  EXPECT_EQ(ask(":TRIG:COUN 3;COUN?"), "3\n");
  EXPECT_EQ(ask(":TRAC:FEED:CONT NEXT;CONT?"), "NEXT\n");
  EXPECT_EQ(ask("FORM:DATA?"), "ASC\n");
  EXPECT_TRUE(firmware.unserved().all().empty());
}

class Keithley2001Test : public ScpiTest {
 protected:
  Keithley2001Test() : ScpiTest(scpi_model("2001")) {}
};

// Queries of EPICS: the buffer is full when bit 9 of the measurement events says so.
TEST_F(Keithley2001Test, ScansByItsArmLayer) {
  constexpr std::string_view kNone = "0, \"no error\"\n";
  EXPECT_EQ(ask("*IDN?"), "KEITHLEY INSTRUMENTS INC.,MODEL 2001,MY44012345,B17  /A02  \n");
  EXPECT_EQ(command(":SAMP:COUN 3"), "-113,\"Undefined header\"\n");
  EXPECT_EQ(command("*CLS;*SRE 1;:STAT:MEAS:ENAB 512;:INIT:CONT OFF"), kNone);
  EXPECT_EQ(command(":ROUT:SCAN (@1,2,3)"), kNone);
  EXPECT_EQ(command(":ROUT:SCAN:LSEL INT"), kNone);
  EXPECT_EQ(command(":ARM:LAY2:COUN 1"), kNone);
  EXPECT_EQ(ask(":ARM:LAYER2:COUNT?"), "1\n");
  EXPECT_EQ(command(":TRIG:COUN 3"), kNone);
  EXPECT_EQ(command(":FORM:ELEM READ,CHAN,UNIT"), kNone);
  EXPECT_EQ(command(":DATA:FEED SENS1;:DATA:FEED:CONT NEXT"), kNone);
  EXPECT_EQ(ask(":INIT"), "");
  EXPECT_EQ(ask("*STB?"), "0\n");
  host.listen(seconds(1));
  EXPECT_EQ(ask("*STB?"), "65\n");
  EXPECT_EQ(ask(":DATA:DATA?"),
            "+5.0000000E-01VDC,01INTCHAN,-2.5000000E-01VDC,02INTCHAN,+3.1250000E+00VDC,03INTCHAN\n");
  EXPECT_EQ(ask(":STAT:MEAS?"), "544\n");  // reading available, buffer full
  EXPECT_EQ(ask("*STB?"), "0\n");
}

TEST(ScpiModelTest, EveryModelSaysWhatItIs) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  for (const auto& [model, identity] : std::vector<std::pair<std::string, std::string>>{
           {"34970A", "HEWLETT-PACKARD,34970A,MY44012345,13-2-2"},
           {"34972A", "Agilent Technologies,34972A,MY44012345,1.16-1.12-02-02"},
           {"34401A", "HEWLETT-PACKARD,34401A,0,11-5-2"},
           {"34465A", "Keysight Technologies,34465A,MY44012345,A.03.01-03.15-03.01-00.52-03-02"},
           {"2700", "KEITHLEY INSTRUMENTS INC.,MODEL 2700,MY44012345,B09  /A02  "}}) {
    ScpiVoltmeterFirmware firmware(bench, scpi_model(model));
    FirmwareHost host(firmware);
    EXPECT_EQ(host.exchange("*IDN?\n"), identity + "\n");
  }
  EXPECT_THROW(scpi_model("3458A"), std::invalid_argument);
}

// The loop of public hosts: *ESE 1, INIT, *OPC, and bit 5 of the status byte is polled until it is set.
TEST_F(Keysight34970aTest, OpcTellsTheEndOfTheMeasurementWithoutWaiting) {
  EXPECT_EQ(ask("*ESR?"), "+128\n") << "power on";
  EXPECT_EQ(ask("*ESR?"), "+0\n");
  command("CONF:VOLT:DC 10,DEF,(@101:103)");
  ask("*ESE 1");
  EXPECT_EQ(ask("*ESE?"), "+1\n");
  EXPECT_EQ(ask("INIT;*OPC"), "");
  EXPECT_EQ(ask("*STB?"), "+0\n");
  EXPECT_EQ(ask("STAT:OPER:COND?"), "+16\n");
  host.listen(milliseconds(200));
  EXPECT_EQ(ask("*STB?"), "+32\n");
  EXPECT_EQ(ask("*ESR?"), "+1\n");
  EXPECT_EQ(ask("*STB?"), "+0\n");
  EXPECT_EQ(ask("STAT:OPER:COND?"), "+0\n");
  EXPECT_EQ(ask("STAT:OPER?"), "+16\n") << "latched until it is read";
  EXPECT_EQ(ask("STAT:OPER?"), "+0\n");
  ask("*OPC");
  EXPECT_EQ(ask("*ESR?"), "+1\n") << "at once if nothing is under way";
}

TEST_F(Keysight34970aTest, ErrorsAreEventsByTheirKind) {
  ask("*CLS");
  ask("HELLO");
  EXPECT_EQ(ask("*ESR?"), "+32\n");
  ask("CONF:VOLT:DC 1000,MAX,(@101)");
  EXPECT_EQ(ask("*ESR?"), "+16\n");
  ask("*ESE 32;*SRE 32;HELLO");
  EXPECT_EQ(ask("*STB?"), "+96\n");
  ask("STAT:PRES");
  EXPECT_EQ(ask("*STB?"), "+96\n") << "only the enable registers of the groups";
  ask("*CLS");
  EXPECT_EQ(ask("*STB?"), "+0\n");
  EXPECT_EQ(ask("*SRE?"), "+32\n") << "*CLS leaves what counts";
  EXPECT_EQ(command("*ESE 256"), "-222,\"Data out of range\"\n");
}

TEST_F(Keysight34970aTest, AnOverloadIsAQuestionableEvent) {
  command("STAT:QUES:ENAB 1");
  command("CONF:VOLT:DC 1,MAX,(@101:103)");
  ask("READ?", seconds(1));
  EXPECT_EQ(ask("*STB?"), "+8\n");
  EXPECT_EQ(ask("STAT:QUES:EVEN?"), "+1\n");
  EXPECT_EQ(ask("*STB?"), "+0\n");
}

TEST_F(Keysight34970aTest, AnswersWhatPublicHostsAskAtTheStart) {
  EXPECT_EQ(ask("abor;*rst;*cls"), "");
  EXPECT_EQ(ask("diag:dmm:cycl?"), "+0,+0,+0\n");
  EXPECT_EQ(ask("diag:peek:slot:data? 100"), "+0,+0,+0\n");
  EXPECT_EQ(ask("diag:rel:cycl? (@101:103)"), "+0,+0,+0\n");
  EXPECT_EQ(command("disp:text 'wait; please'"), kNoError);
  EXPECT_EQ(command("DISP:TEXT:CLE"), kNoError);
  EXPECT_EQ(ask("SYST:DATE?"), "+2026,+1,+1\n");
}

TEST_F(Keysight34970aTest, WhatItDoesNotKnowIsNotedOnce) {
  ask("CONF:FREQ 1,(@101)");
  ask("CONF:FREQ 1,(@102)");
  ASSERT_EQ(firmware.unserved().all().size(), 1U);
  EXPECT_EQ(firmware.unserved().all()[0].command, "CONF:FREQ");
  EXPECT_EQ(firmware.unserved().all()[0].count, 2U);
}

TEST_F(Keysight34970aTest, ANewSessionStartsWithAnEmptyLine) {
  host.send("TRIG:COUN 1");
  firmware.session_starts();
  EXPECT_EQ(command("*CLS"), kNoError);
  EXPECT_EQ(ask("TRIG:COUN?"), "+1.00000000E+00\n");
}

TEST(Keysight34401aModelTest, HasNoOperationRegisterAndTellsAnOverloadAsADeviceError) {
  const auto bench = std::make_shared<SimBench>(truth_in_volts());
  auto settings = scpi_model("34401A");
  settings.single_channel = 2;
  ScpiVoltmeterFirmware firmware(bench, settings);
  FirmwareHost host(firmware);
  EXPECT_EQ(host.exchange("STAT:OPER:COND?\n"), "");
  EXPECT_EQ(host.exchange("*CLS\n"), "");
  host.send("CONF:VOLT:DC 1,MAX;:READ?\n");
  host.listen(seconds(1));
  EXPECT_EQ(host.exchange("*ESR?\n"), "+8\n");
  EXPECT_EQ(host.exchange("SYST:ERR?\n"), kNoError) << "without an entry in the queue";
}

TEST(Keysight34465aModelTest, TheStatusByteHasABitOfItsErrorQueue) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  ScpiVoltmeterFirmware firmware(bench, scpi_model("34465A"));
  FirmwareHost host(firmware);
  host.exchange("HELLO\n");
  EXPECT_EQ(host.exchange("*STB?\n"), "+4\n");
  host.exchange("SYST:ERR?\n");
  EXPECT_EQ(host.exchange("*STB?\n"), "+0\n");
}

TEST(ScpiSettingsTest, RefusesWhatCannotBe) {
  const auto bench = std::make_shared<SimBench>(BenchTruth{});
  EXPECT_THROW(ScpiVoltmeterFirmware(bench, {.channels = {101, 101, 102}}), std::invalid_argument);
  EXPECT_THROW(ScpiVoltmeterFirmware(bench, {.single_channel = 3}), std::invalid_argument);
  EXPECT_THROW(ScpiVoltmeterFirmware(bench, {.line_frequency_hz = 0.0}), std::invalid_argument);
}

TEST_F(Keysight34970aTest, WithoutPowerItForgetsAndSaysSo) {
  EXPECT_EQ(command("CONF:VOLT:DC 1,MAX,(@101)"), kNoError);
  ask("*ESR?");
  ask("*SRE 32");
  ask("NOPE");
  firmware.power(false, host.clock().now());
  firmware.power(true, host.clock().now());
  EXPECT_EQ(ask("*ESR?"), "+128\n");
  EXPECT_EQ(ask("*SRE?"), "+0\n");
  EXPECT_EQ(ask("SYST:ERR?"), kNoError);
  EXPECT_EQ(ask("ROUT:SCAN?"), "#13(@)\n");
  EXPECT_EQ(firmware.line_speed(), 9600U);
}

}  // namespace
}  // namespace abcal::sim
