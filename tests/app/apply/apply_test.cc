// The whole loop for each family of instruments: a run, its constants written into the registers of the
// simulated instrument, and a run afterwards; and failures on the way.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "app/commands/apply/apply_session.h"
#include "app/commands/apply/apply_text.h"
#include "drivers/instrument/instrument_error.h"
#include "tests/support/temporary_folder.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

struct Family {
  std::string name;
  std::string accelerometer;  ///< [accelerometer] without its port.
  double unit_mps2 = 9.81;    ///< Rounded: sufficient for the truth.
  double noise = 1e-4;        ///< g
  std::string more;           ///< Further sections.
  RegisterTexts earlier{};    ///< Content before the run, other than from the factory.
  double tolerance = 0.1;     ///< Tolerance of the sensitivity.
};

void PrintTo(const Family& family, std::ostream* out) {
  *out << family.name;
}

constexpr const char* kCompensation = "acceleration compensation (25)";

const std::vector<Family>& families() {
  static const std::vector<Family> all{
      {"vectornav",
       "driver = \"vectornav\"\nrate_hz = 200.0\nresponse_unit = \"m/s2\"\n",
       1.0,
       1e-4,
       "",
       {{kCompensation, "1.02,0.01,0,0.005,0.97,-0.01,0,0.003,1.01,0.2,-0.1,0.3"}}},
      {"microstrain",
       "driver = \"microstrain_mip\"\nrate_hz = 200.0\nresponse_unit = \"g\"\n",
       9.80665,
       1e-4,
       "",
       {{"accelerometer bias (0C,37)", "0.01, -0.02, 0.005 g"}}},
      {"witmotion",
       "driver = \"witmotion\"\nrate_hz = 200.0\nbaud = 115200\nresponse_unit = \"g\"\n",
       9.80665,
       2e-3,
       "",
       {{"acceleration offsets (05-07)", "0.0100, -0.0200, 0.0050 g"}}},
      {"iio",
       "driver = \"iio\"\nrate_hz = 200.0\nresponse_unit = \"m/s2\"\n",
       1.0,
       1e-4,
       "",
       {{"accel_x calibbias", "1000000"},
        {"accel_y calibbias", "-2000000"},
        {"accel_z calibbias", "0"},
        {"accel_x calibscale", "1.020000"},
        {"accel_y calibscale", "0.970000"},
        {"accel_z calibscale", "1.000000"}}},
      {"px4",
       "driver = \"mavlink\"\nrate_hz = 200.0\nresponse_unit = \"m/s2\"\n",
       1.0,
       1e-4,
       "",
       {{"CAL_ACC0_XOFF", "0.2"},
        {"CAL_ACC0_YOFF", "-0.1"},
        {"CAL_ACC0_ZOFF", "0.3"},
        {"CAL_ACC0_XSCALE", "1.02"},
        {"CAL_ACC0_YSCALE", "0.97"},
        {"CAL_ACC0_ZSCALE", "1.01"}}},
      {"ardupilot",
       "driver = \"mavlink\"\nrate_hz = 200.0\nresponse_unit = \"m/s2\"\n",
       1.0,
       1e-4,
       "[emulator]\naccelerometer_model = \"ArduPilot\"\n",
       {{"INS_ACCOFFS_X", "0.2"},
        {"INS_ACCOFFS_Y", "-0.1"},
        {"INS_ACCOFFS_Z", "0.3"},
        {"INS_ACCSCAL_X", "1.02"},
        {"INS_ACCSCAL_Y", "0.97"},
        {"INS_ACCSCAL_Z", "1.01"}}}};
  return all;
}

/// An instrument that reports its serial number is the item of this number.
std::string item_section(const Family& family) {
  return std::string("[item]\n") + (family.name == "witmotion" ? "serial_number = \"LABEL-7\"\n" : "");
}

std::string bench_of(const Family& family) {
  const double k = 9.81 / family.unit_mps2;
  const auto row = [k](double a, double b, double c) {
    return fmt::format("[{}, {}, {}]", k * a, k * b, k * c);
  };
  return "[bench]\ng_loc_mps2 = 9.81\n" + item_section(family) +
         fmt::format("sensitivity_tolerance = {}\n", family.tolerance) +
         std::string(
             "[stage]\ndriver = \"simulated\"\nport = \"simulated\"\n[accelerometer]\nport = "
             "\"simulated\"\n") +
         family.accelerometer +
         "[protocol]\ncheck_poses = false\nsteps = 12\nstep_deg = 30.0\nsettle_s = 0.05\ndwell_readings = "
         "100\n" +
         family.more + "[simulation]\nseed = 5\nsensitivity_matrix = [" + row(1.01, 0.002, -0.001) + ", " +
         row(-0.003, 0.98, 0.002) + ", " + row(0.001, -0.002, 1.02) +
         "]\noffset = " + row(0.01, -0.02, 0.03) + fmt::format("\nnoise = {}\n", k * family.noise) +
         "[simulation.x]\nspeed_deg_per_s = 700.0\nacceleration_deg_per_s2 = 20000.0\nstep_error_deg = "
         "0.005\n"
         "[simulation.z]\nspeed_deg_per_s = 700.0\nacceleration_deg_per_s2 = 20000.0\nstep_error_deg = "
         "0.005\n";
}

/// Called with "identify", "correction_registers", "write", "written", "save", "saved" and "start". Its
/// exceptions are those of the instrument.
using Hook = std::function<void(std::string_view call)>;

/// The accelerometer of a bench, and its registers, with a hook before each call.
class HookedAccelerometer final : public Accelerometer, public CorrectionRegisters {
 public:
  HookedAccelerometer(std::unique_ptr<Accelerometer> inner, Hook& hook)
      : inner_(std::move(inner)), hook_(hook) {}

  AccelerometerInfo identify() override {
    call("identify");
    return inner_->identify();
  }
  std::map<std::string, std::string> correction_registers() override {
    call("correction_registers");
    return inner_->correction_registers();
  }
  CorrectionRegisters* corrections() override { return inner_->corrections() == nullptr ? nullptr : this; }
  void start() override {
    call("start");
    inner_->start();
  }
  std::optional<Reading> next(Clock::Instant deadline) override { return inner_->next(deadline); }
  void discard_pending() override { inner_->discard_pending(); }
  StreamHealth health() const override { return inner_->health(); }
  void stop() noexcept override { inner_->stop(); }

  CorrectionAbility ability() override { return inner_->corrections()->ability(); }
  OutputCorrection decode(const RegisterTexts& registers) override {
    return inner_->corrections()->decode(registers);
  }
  RegisterTexts encode(const OutputCorrection& wanted, const RegisterTexts& now) override {
    return inner_->corrections()->encode(wanted, now);
  }
  void require_writable() override { inner_->corrections()->require_writable(); }
  void write(const RegisterTexts& registers) override {
    call("write");
    inner_->corrections()->write(registers);
    call("written");
  }
  void save(const RegisterTexts& registers) override {
    call("save");
    inner_->corrections()->save(registers);
    call("saved");
  }

 private:
  void call(std::string_view name) const {
    if (hook_) hook_(name);
  }

  std::unique_ptr<Accelerometer> inner_;
  Hook& hook_;
};

class ApplyTest : public testing::Test {
 protected:
  /// Opens the bench and puts `earlier` into the registers.
  void open(const Family& family) {
    toml = bench_of(family);
    RunSession::Options options;
    options.open_bench = [this](const BenchConfig& config, BenchStreams streams) {
      Bench bench = make_bench(config, std::move(streams));
      auto& accelerometer = bench.first().accelerometer;
      accelerometer = std::make_unique<HookedAccelerometer>(std::move(accelerometer), hook);
      return bench;
    };
    options.stop = stop.get_token();
    session = std::make_unique<RunSession>(std::move(options));
    (void)session->identify_instruments(start("unused.run"));
    if (!family.earlier.empty()) {
      RegisterTexts content = accelerometer().correction_registers();
      for (const auto& [name, value] : family.earlier) content[name] = value;
      accelerometer().corrections()->write(content);
      session->ask_corrections_again();
    }
  }

  Accelerometer& accelerometer() { return *session->bench()->first().accelerometer; }
  StartRequest start(const std::string& name) const {
    return {parse_bench(toml, "bench.toml"), (folder / name).string()};
  }
  ApplyRequest request() const {
    ApplyRequest request;
    request.run = folder / "found.run";
    request.bench = parse_bench(toml, "bench.toml");
    request.bench_file = "bench.toml";
    request.as_left = folder / "left.run";
    request.label = "LABEL-7";
    return request;
  }
  RegisterTexts content() {
    (void)accelerometer().identify();
    return accelerometer().correction_registers();
  }
  ApplySession apply() {
    return {*session, {confirm, [this](const Adjustment& a) { states.emplace_back(to_string(a.state)); }}};
  }
  AdjustmentLog log() const { return AdjustmentLog(folder / "found.run"); }

  test::TemporaryFolder folder;
  std::string toml;
  Hook hook;
  std::stop_source stop;
  std::function<bool(const ApplyReport&)> confirm;
  std::vector<std::string> states;
  std::unique_ptr<RunSession> session;
};

class ApplyToEachFamily : public ApplyTest, public testing::WithParamInterface<Family> {};

/// Three standard uncertainties of both runs and of the step.
double limit(double u_found, double u_left, double step) {
  return 3.0 * std::sqrt(u_found * u_found + u_left * u_left + step * step / 12.0);
}

TEST_P(ApplyToEachFamily, LeavesWhatTheRegistersCanHoldWithinTheUncertainty) {
  open(GetParam());
  session->start(start("found.run"));
  ApplyRequest wanted = request();
  const bool keeps = accelerometer().corrections()->ability().keeps_at_once;
  wanted.save = keeps;
  const ApplyReport report = apply().apply(wanted);
  ASSERT_EQ(report.failure, "");
  ASSERT_TRUE(report.as_left);
  fmt::print("{}\n{}", GetParam().name, outcome_text(report));
  const ResponseErrors& found = report.as_found;
  const ResponseErrors& left = *report.as_left;
  const CorrectionAbility& ability = report.ability;
  EXPECT_GT(found.offset.norm(), 20 * found.u_offset.norm()) << "nothing to correct";
  for (Eigen::Index j = 0; j < 3; ++j) {
    EXPECT_LT(std::abs(left.offset[j]), limit(found.u_offset[j], left.u_offset[j], ability.offset_step)) << j;
    for (Eigen::Index k = 0; k < 3; ++k) {
      const double allowed = limit(found.u_gain(j, k), left.u_gain(j, k), ability.matrix_step);
      const bool held =
          ability.shape == CorrectionShape::kFull || (ability.shape == CorrectionShape::kDiagonal && j == k);
      EXPECT_LT(std::abs(left.gain(j, k) - (held ? 0.0 : report.predicted.gain(j, k))), allowed + 1e-12)
          << j << k;
    }
  }
  EXPECT_EQ(report.state, keeps ? AdjustmentState::kSaved : AdjustmentState::kVerified);
  EXPECT_EQ(RunFile::load(folder / "left.run").header.items.front().registers, content());
  EXPECT_EQ(RunFile::load(folder / "left.run").header.labels.at("apply.of"), "found.run");
}

TEST_P(ApplyToEachFamily, UndoBringsTheOldRegistersBack) {
  open(GetParam());
  session->start(start("found.run"));
  const RegisterTexts before = content();
  ApplyRequest wanted = request();
  wanted.save = accelerometer().corrections()->ability().keeps_at_once;
  ASSERT_EQ(apply().apply(wanted).failure, "");
  ASSERT_NE(content(), before);
  wanted.save = false;
  EXPECT_EQ(apply().undo(wanted).state, AdjustmentState::kUndone);
  EXPECT_EQ(content(), before);
  EXPECT_THROW(apply().undo(wanted), std::invalid_argument);
}

INSTANTIATE_TEST_SUITE_P(All, ApplyToEachFamily, testing::ValuesIn(families()),
                         [](const auto& family) { return family.param.name; });

// After a run with several items, the constants of one item go into that item only.
TEST_F(ApplyTest, OneOfSeveralItemsIsWrittenVerifiedAndUndone) {
  const Family& family = families()[1];  // Its simulated instruments have serial numbers of their own.
  toml = bench_of(family);
  const std::string accelerometer = "port = \"simulated\"\n" + family.accelerometer;
  for (const std::string& section :
       {item_section(family) + fmt::format("sensitivity_tolerance = {}\n", family.tolerance),
        "[accelerometer]\n" + accelerometer}) {
    ASSERT_NE(toml.find(section), std::string::npos);
    toml.erase(toml.find(section), section.size());
  }
  for (int k = 1; k <= 2; ++k)
    toml += fmt::format("[[item]]\nsensitivity_tolerance = {}\n[item.accelerometer]\n{}", family.tolerance,
                        accelerometer);
  session = std::make_unique<RunSession>(RunSession::Options{});
  session->start(start("found.run"));
  const auto registers_of = [&](std::size_t k) {
    Accelerometer* item = session->bench()->items.at(k - 1).accelerometer.get();
    (void)item->identify();
    return item->correction_registers();
  };
  const RegisterTexts first = registers_of(1), second = registers_of(2);
  ApplyRequest wanted = request();
  wanted.label.clear();
  EXPECT_THROW(apply().apply(wanted), std::invalid_argument) << "which item?";
  wanted.item = 2;
  const ApplyReport report = apply().apply(wanted);
  ASSERT_EQ(report.failure, "");
  EXPECT_EQ(report.state, AdjustmentState::kVerified);
  EXPECT_EQ(report.serial_number, RunFile::load(folder / "found.run", 2).own_item().serial_number);
  EXPECT_EQ(registers_of(1), first);
  EXPECT_EQ(registers_of(2), report.after);
  EXPECT_NE(report.after, second);
  EXPECT_EQ(RunFile::load(folder / "left.run", 1).own_item().registers, first);
  EXPECT_EQ(RunFile::load(folder / "left.run", 2).own_item().registers, report.after);
  EXPECT_LT(report.as_left->offset.norm(), 0.1 * report.as_found.offset.norm());
  wanted.item = 1;
  EXPECT_THROW(apply().undo(wanted), std::invalid_argument) << "nothing was written into it";
  wanted.item = 2;
  EXPECT_EQ(apply().undo(wanted).state, AdjustmentState::kUndone);
  EXPECT_EQ(registers_of(2), second);
}

TEST_F(ApplyTest, ASecondApplyOfTheSameRunWritesTheSame) {
  open(families()[0]);
  session->start(start("found.run"));
  const ApplyReport first = apply().apply(request());
  ApplyRequest again = request();
  again.as_left = folder / "left-2.run";
  const ApplyReport second = apply().apply(again);
  EXPECT_EQ(second.failure, "");
  EXPECT_EQ(second.after, first.after);
  EXPECT_NE(second.before, first.before);
}

TEST_F(ApplyTest, ADoubtfulResultIsWrittenOnlyIfSomebodySaysSo) {
  Family strict = families()[1];
  strict.tolerance = 0.005;  // The scales are 2 % off.
  open(strict);
  session->start(start("found.run"));
  ApplyRequest wanted = request();
  EXPECT_THROW((void)apply().apply(wanted), std::invalid_argument);
  wanted.accept_doubtful = true;
  const ApplyReport report = apply().apply(wanted);
  EXPECT_EQ(report.failure, "");
  EXPECT_EQ(report.found.verdict, Verdict::kDoubtful);
}

TEST_F(ApplyTest, ADryRunWritesNothing) {
  open(families()[0]);
  session->start(start("found.run"));
  const RegisterTexts before = content();
  hook = [](std::string_view call) { EXPECT_NE(call, "write"); };
  ApplyRequest wanted = request();
  wanted.dry_run = true;
  const ApplyReport report = apply().apply(wanted);
  EXPECT_NE(report.after.at(kCompensation), before.at(kCompensation));
  EXPECT_EQ(content(), before);
  EXPECT_FALSE(std::filesystem::exists(AdjustmentLog::path_beside(wanted.run)));
  EXPECT_EQ(apply_json(report).at("state"), "dry run");
}

TEST_F(ApplyTest, WithoutConsentNothingIsWrittenAndTheOldContentIsKeptBefore) {
  open(families()[0]);
  session->start(start("found.run"));
  const RegisterTexts before = content();
  confirm = [&](const ApplyReport&) {
    EXPECT_EQ(log().all().back().before, before);
    return false;
  };
  hook = [](std::string_view call) { EXPECT_NE(call, "write"); };
  EXPECT_EQ(apply().apply(request()).state, AdjustmentState::kDeclined);
  EXPECT_EQ(log().last_to_undo(1), nullptr);
}

TEST_F(ApplyTest, AnotherSerialNumberIsRefused) {
  open(families()[1]);
  session->start(start("found.run"));
  const auto message = [&] {
    try {
      (void)apply().apply(request());
    } catch (const InstrumentError& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  // Another device on the same bench.
  Family other = families()[1];
  other.accelerometer += "serial_number = \"0000.999999\"\n";
  open(other);
  hook = [](std::string_view call) { EXPECT_NE(call, "write"); };
  EXPECT_THAT(message(),
              AllOf(HasSubstr("serial number 0000.999999; required: "), HasSubstr("Nothing was written")));
}

TEST_F(ApplyTest, AnInstrumentWithoutASerialNumberNeedsItsLabel) {
  open(families()[2]);
  session->start(start("found.run"));
  hook = [](std::string_view call) { EXPECT_NE(call, "write"); };
  for (const std::string label : {"", "LABEL-8"}) {
    ApplyRequest wanted = request();
    wanted.label = label;
    EXPECT_THROW((void)apply().apply(wanted), InstrumentError) << label;
  }
}

TEST_F(ApplyTest, WhatIsKeptAtOnceIsWrittenOnlyIfItIsToBeSaved) {
  open(families()[4]);
  session->start(start("found.run"));
  hook = [](std::string_view call) { EXPECT_NE(call, "write"); };
  EXPECT_THROW((void)apply().apply(request()), InstrumentError);
}

TEST_F(ApplyTest, WhatCannotBeSavedIsNotWritten) {
  open(families()[3]);
  session->start(start("found.run"));
  hook = [](std::string_view call) { EXPECT_NE(call, "write"); };
  ApplyRequest wanted = request();
  wanted.save = true;
  EXPECT_THROW((void)apply().apply(wanted), InstrumentError);
}

/// The first call of a kind, made after the old content was kept, fails.
class ApplyFails : public ApplyTest, public testing::WithParamInterface<const char*> {
 protected:
  void fail_once_at(const std::string& where) {
    confirm = [this, where](const ApplyReport&) {
      hook = [this, where](std::string_view call) {
        if (call != where) return;
        hook = {};
        throw InstrumentError("accelerometer", Fault::kRefused, "made to fail");
      };
      return true;
    };
  }
};

TEST_P(ApplyFails, AtAnyStepTheOldRegistersComeBack) {
  open(families()[0]);
  session->start(start("found.run"));
  const RegisterTexts before = content();
  fail_once_at(GetParam());
  ApplyRequest wanted = request();
  wanted.save = true;
  const ApplyReport report = apply().apply(wanted);
  EXPECT_THAT(report.failure, AllOf(HasSubstr("made to fail"), HasSubstr("old registers are back")));
  EXPECT_EQ(report.state, AdjustmentState::kUndone);
  EXPECT_EQ(content(), before);
  EXPECT_EQ(log().last_to_undo(1), nullptr);
}

INSTANTIATE_TEST_SUITE_P(Steps, ApplyFails,
                         testing::Values("identify", "write", "written", "correction_registers", "start",
                                         "save", "saved"),
                         [](const auto& step) { return std::string(step.param); });

TEST_F(ApplyTest, WhatIsNotTakenIsFoundByReadingBack) {
  open(families()[0]);
  session->start(start("found.run"));
  const RegisterTexts before = content();
  confirm = [&](const ApplyReport&) {
    hook = [&](std::string_view call) {
      if (call != "written") return;
      hook = {};
      accelerometer().corrections()->write(before);  // Undoes the writing.
    };
    return true;
  };
  const ApplyReport report = apply().apply(request());
  EXPECT_THAT(report.failure, AllOf(HasSubstr("read back as"), HasSubstr("old registers are back")));
  EXPECT_EQ(content(), before);
}

TEST_F(ApplyTest, AVerificationThatContradictsIsUndone) {
  open(families()[0]);
  session->start(start("found.run"));
  const RegisterTexts before = content();
  confirm = [&](const ApplyReport&) {
    hook = [&](std::string_view call) {
      if (call != "start") return;
      hook = {};  // After the registers were read back, their content changes.
      RegisterTexts other = before;
      other[kCompensation] = "1,0,0,0,1,0,0,0,1,0,0,0";
      accelerometer().corrections()->write(other);
    };
    return true;
  };
  const ApplyReport report = apply().apply(request());
  EXPECT_THAT(report.failure,
              AllOf(HasSubstr("contradicts what was written"), HasSubstr("old registers are back")));
  EXPECT_EQ(content(), before);
}

TEST_F(ApplyTest, AnInterruptedVerificationIsUndone) {
  open(families()[0]);
  session->start(start("found.run"));
  const RegisterTexts before = content();
  confirm = [&](const ApplyReport&) {
    hook = [&](std::string_view call) {
      if (call == "start") session->request_stop();
    };
    return true;
  };
  const ApplyReport report = apply().apply(request());
  EXPECT_TRUE(report.interrupted);
  EXPECT_EQ(report.state, AdjustmentState::kUndone);
  EXPECT_EQ(content(), before);
}

TEST_F(ApplyTest, WhatCannotBeUndoneIsSaidAndUndoneLater) {
  open(families()[0]);
  session->start(start("found.run"));
  const RegisterTexts before = content();
  confirm = [&](const ApplyReport&) {
    hook = [](std::string_view call) {
      if (call == "start" || call == "written")
        throw InstrumentError("accelerometer", Fault::kLinkLost, "unplugged");
    };
    return true;
  };
  const ApplyReport report = apply().apply(request());
  EXPECT_EQ(report.state, AdjustmentState::kUndoFailed);
  EXPECT_THAT(report.failure, AllOf(HasSubstr("COULD NOT BE BROUGHT BACK"), HasSubstr("--undo")));
  confirm = {};
  hook = {};
  EXPECT_THROW((void)apply().apply(request()), std::invalid_argument)
      << "an unfinished one is not passed over";
  EXPECT_EQ(apply().undo(request()).state, AdjustmentState::kUndone);
  EXPECT_EQ(content(), before);
}

// ---- Numbers

CorrectionConstants constants(const Eigen::Matrix3d& S, const Eigen::Vector3d& b) {
  CorrectionConstants made;
  made.M = S.inverse();
  made.b = b;
  made.response_unit = "m/s2";
  made.unit_mps2 = 1.0;
  return made;
}

TEST(ComposedTest, CorrectsWhatIsLeftAfterWhatWasInForce) {
  OutputCorrection in_force;
  in_force.matrix << 1.02, 0.01, 0.0, 0.005, 0.97, -0.01, 0.0, 0.003, 1.01;
  in_force.offset = {0.2, -0.1, 0.3};
  Eigen::Matrix3d S;
  S << 1.01, 0.0, 0.0, 0.02, 0.99, 0.0, -0.01, 0.005, 1.0;
  const CorrectionConstants found = constants(S, {0.3, 0.1, -0.2});
  const OutputCorrection wanted = composed(found, in_force, CorrectionShape::kFull);
  // A raw reading, computed by hand: the output of the instrument, and the acceleration.
  const Eigen::Vector3d raw(1.0, -4.0, 8.0);
  const Eigen::Vector3d output = in_force.matrix * (raw - in_force.offset);
  const Eigen::Vector3d acceleration = S.inverse() * (output - found.b);
  EXPECT_LT((wanted.matrix * (raw - wanted.offset) - acceleration).norm(), 1e-12);
  const ResponseErrors none = errors_with(found, in_force, wanted);
  EXPECT_LT(none.gain.norm() + none.offset.norm(), 1e-12);
  const ResponseErrors before = errors_with(found, in_force, in_force);
  EXPECT_LT((before.gain - (S - Eigen::Matrix3d::Identity())).norm() + (before.offset - found.b).norm(),
            1e-12);
}

TEST(ComposedTest, OffsetsAloneMakeTheOutputZeroWhereNothingPulls) {
  OutputCorrection in_force;
  in_force.matrix = Eigen::Vector3d(1.1, 0.9, 1.0).asDiagonal();
  const CorrectionConstants found =
      constants(Eigen::Vector3d(1.01, 0.99, 1.0).asDiagonal(), {0.3, 0.1, -0.2});
  for (const CorrectionShape shape : {CorrectionShape::kOffset, CorrectionShape::kDiagonal}) {
    const OutputCorrection wanted = composed(found, in_force, shape);
    const ResponseErrors left = errors_with(found, in_force, wanted);
    EXPECT_LT(left.offset.norm(), 1e-12);
    EXPECT_NEAR(left.gain(0, 0), shape == CorrectionShape::kOffset ? 0.01 : 0.0, 1e-12);
  }
}

}  // namespace
}  // namespace abcal
