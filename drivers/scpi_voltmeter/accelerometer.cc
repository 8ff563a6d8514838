#include "drivers/scpi_voltmeter/accelerometer.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <iterator>
#include <set>
#include <stdexcept>
#include <utility>

#include "drivers/instrument/instrument_error.h"

namespace abcal {
namespace {

using scpi::Meter;

constexpr unsigned kMostLostInARow = 3;

// The voltmeter knows its line frequency, we do not: the faster one where a rate may be possible, the slower
// one where a scan may still arrive.
constexpr double kFastLineHz = 60.0;
constexpr double kSlowLineHz = 50.0;
// An automatic zero measures twice. It is set for the Keysight scanners; the others keep their own setting.
constexpr double kWithZero = 2.0;
constexpr std::chrono::seconds kScanMargin{3};
// Scans that judge a rate that the first one missed.
constexpr int kTrialScans = 10;
constexpr double kLongestTrialS = 10.0;

constexpr std::string_view kKnownScanners =
    "known are the scanning voltmeters 34970A, 34972A and DAQ970A (Keysight, Agilent, HP) and 2700 and 2001 "
    "(Keithley)";
constexpr std::string_view kKnownSingles =
    "known are the voltmeters 34401A, 34460A, 34461A, 34465A and 34470A (Keysight, Agilent, HP)";

bool is_maker(const scpi::Identity& identity, std::initializer_list<std::string_view> beginnings) {
  std::string maker = identity.maker;
  std::transform(maker.begin(), maker.end(), maker.begin(),
                 [](char c) { return static_cast<char>(std::toupper(static_cast<unsigned char>(c))); });
  return std::any_of(beginnings.begin(), beginnings.end(),
                     [&](std::string_view beginning) { return maker.starts_with(beginning); });
}

bool is_model(const scpi::Identity& identity, std::initializer_list<std::string_view> models) {
  return std::find(models.begin(), models.end(), identity.model) != models.end();
}

void check_settings(const AccelerometerSettings& settings, bool uses_channels) {
  std::vector<std::string> problems;
  const auto require_positive = [&](std::string_view name, double value) {
    if (!(value > 0.0) || !std::isfinite(value))
      problems.push_back(fmt::format("{} is {}; required: a positive number", name, value));
  };
  require_positive("rate_hz", settings.rate_hz);
  require_positive("range_v", settings.range_v);
  require_positive("integration_plc", settings.integration_plc);
  for (const double scale : settings.scale)
    if (!std::isfinite(scale) || scale == 0.0)
      problems.push_back(
          fmt::format("scale has {}; required: numbers other than 0, in volts per unit", scale));
  for (const double bias : settings.bias)
    if (!std::isfinite(bias)) problems.push_back(fmt::format("bias has {}; required: volts", bias));
  const std::set<int> distinct(settings.channels.begin(), settings.channels.end());
  if (uses_channels && (distinct.size() != settings.channels.size() || *distinct.begin() < 1)) {
    problems.push_back(fmt::format("channels are {}; required: three different numbers from 1",
                                   fmt::join(settings.channels, ", ")));
  }
  if (!problems.empty())
    throw std::invalid_argument(fmt::format("SCPI voltmeter: {}", fmt::join(problems, "; ")));
}

/// Rounded down to three digits, so that a rate printed as permitted is permitted.
double rounded_down(double positive) {
  const double unit = std::pow(10.0, std::floor(std::log10(positive)) - 2.0);
  return std::floor(positive / unit) * unit;
}

/// The word itself if all are equal, otherwise all of them joined.
std::string joined(const std::vector<std::string>& words) {
  const bool same = std::all_of(words.begin(), words.end(), [&](const auto& w) { return w == words[0]; });
  return same ? words[0] : fmt::format("{}", fmt::join(words, ", "));
}

template <class... Streams>
std::vector<std::unique_ptr<wire::ByteStream>> in_a_row(Streams... streams) {
  std::vector<std::unique_ptr<wire::ByteStream>> row;
  (row.push_back(std::move(streams)), ...);
  return row;
}

}  // namespace

VoltmeterAccelerometer::VoltmeterAccelerometer(Wiring wiring,
                                               std::vector<std::unique_ptr<wire::ByteStream>> streams,
                                               Clock& clock, const AccelerometerSettings& settings)
    : wiring_(wiring), clock_(clock), settings_(settings) {
  check_settings(settings_, wiring_ == Wiring::kOneScanner);
  for (auto& stream : streams) {
    if (stream == nullptr) throw std::invalid_argument("SCPI voltmeter: no stream");
    meters_.emplace_back(std::move(stream), clock_);
    const auto patience = kScanMargin + from_seconds(slowest_scan_s());
    meters_.back().set_plan({wiring_ == Wiring::kOneScanner
                                 ? std::vector<int>(settings_.channels.begin(), settings_.channels.end())
                                 : std::vector<int>(),
                             patience});
  }
  outcomes_.resize(meters_.size());
}

VoltmeterAccelerometer::~VoltmeterAccelerometer() = default;

ScpiScanningVoltmeter::ScpiScanningVoltmeter(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                             const AccelerometerSettings& settings)
    : VoltmeterAccelerometer(Wiring::kOneScanner, in_a_row(std::move(stream)), clock, settings) {}

ScpiSingleVoltmeters::ScpiSingleVoltmeters(std::array<std::unique_ptr<wire::ByteStream>, 3> streams,
                                           Clock& clock, const AccelerometerSettings& settings)
    : VoltmeterAccelerometer(Wiring::kThreeSingles,
                             in_a_row(std::move(streams[0]), std::move(streams[1]), std::move(streams[2])),
                             clock, settings) {}

/// The longest that a scan can rightly last, without switching.
double VoltmeterAccelerometer::slowest_scan_s() const {
  const double channels = wiring_ == Wiring::kOneScanner ? 3.0 : 1.0;
  // Twice again: a voltmeter may choose the next longer integration time that it has.
  return 2.0 * channels * kWithZero * settings_.integration_plc / kSlowLineHz;
}

VoltmeterAccelerometer::Family VoltmeterAccelerometer::family_of(const Meter& meter,
                                                                 const scpi::Identity& identity) const {
  const bool keysight = is_maker(identity, {"HEWLETT-PACKARD", "AGILENT", "KEYSIGHT"});
  const bool keithley = is_maker(identity, {"KEITHLEY"});
  if (wiring_ == Wiring::kThreeSingles) {
    if (keysight && is_model(identity, {"34401A", "34460A", "34461A", "34465A", "34470A"}))
      return Family::kSingle;
  } else {
    if (keysight && is_model(identity, {"34970A", "34972A", "DAQ970A"})) return Family::kKeysightScanner;
    if (keithley && is_model(identity, {"2700"})) return Family::kKeithley2700;
    if (keithley && is_model(identity, {"2001"})) return Family::kKeithley2001;
  }
  meter.fail(Fault::kWrongIdentity,
             fmt::format("it reports model \"{}\" of \"{}\"; {}", identity.model, identity.maker,
                         wiring_ == Wiring::kOneScanner ? kKnownScanners : kKnownSingles));
}

AccelerometerInfo VoltmeterAccelerometer::identify() {
  started_ = false;
  families_.clear();
  std::vector<std::string> makers, models, serial_numbers, firmwares;
  for (Meter& meter : meters_) {
    const scpi::Identity identity = meter.identify();
    families_.push_back(family_of(meter, identity));
    makers.push_back(identity.maker);
    models.push_back(identity.model);
    serial_numbers.push_back(identity.serial_number);
    firmwares.push_back(identity.firmware);
  }
  double full_scale = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    full_scale = std::max(full_scale,
                          (settings_.range_v + std::abs(settings_.bias[i])) / std::abs(settings_.scale[i]));
  }
  return AccelerometerInfo{
      .maker = joined(makers),
      .model = joined(models),
      .serial_number = joined(serial_numbers),
      .firmware = joined(firmwares),
      .output_unit = settings_.unit.empty() ? "V" : settings_.unit,
      .full_scale = settings_.full_scale.value_or(full_scale),
      .resolution = std::nullopt,
      .rate_hz = settings_.rate_hz,
  };
}

std::vector<std::string> VoltmeterAccelerometer::setup(Family family) const {
  const std::string list = scpi::channel_list(settings_.channels);
  const double range = settings_.range_v;
  const double plc = settings_.integration_plc;
  switch (family) {
    case Family::kKeysightScanner:
      return {fmt::format("CONF:VOLT:DC {:g},MAX,{}", range, list),
              fmt::format("SENS:VOLT:DC:NPLC {:g},{}", plc, list),
              fmt::format("SENS:VOLT:DC:ZERO:AUTO ON,{}", list),
              fmt::format("ROUT:SCAN {}", list),
              "TRIG:SOUR IMM",
              "TRIG:COUN 1",
              "FORM:READ:CHAN ON",
              "FORM:READ:UNIT OFF",
              "FORM:READ:TIME OFF"};
    case Family::kKeithley2700:  // Function, range and integration time belong to the channel.
      return {":INIT:CONT OFF",
              fmt::format(":SENS:FUNC \"VOLT\",{}", list),
              fmt::format(":SENS:VOLT:RANG {:g},{}", range, list),
              fmt::format(":SENS:VOLT:NPLC {:g},{}", plc, list),
              ":FORM:ELEM READ,CHAN",
              fmt::format(":ROUT:SCAN {}", list),
              ":ROUT:SCAN:LSEL INT",
              ":TRIG:COUN 1",
              ":SAMP:COUN 3"};
    case Family::kKeithley2001:
      return {
          ":INIT:CONT OFF",
          ":SENS:FUNC \"VOLT\"",
          fmt::format(":SENS:VOLT:RANG {:g}", range),
          fmt::format(":SENS:VOLT:NPLC {:g}", plc),
          ":FORM:ELEM READ,CHAN",
          fmt::format(":ROUT:SCAN {}", list),
          ":ROUT:SCAN:LSEL INT",
          ":ARM:LAY2:COUN 1",  // It has no SAMP:COUN: scans by the arm layer, readings of one by the trigger.
          ":TRIG:COUN 3"};
    case Family::kSingle:
      return {fmt::format("CONF:VOLT:DC {:g}", range), fmt::format("SENS:VOLT:DC:NPLC {:g}", plc),
              "TRIG:SOUR IMM", "TRIG:COUN 1", "SAMP:COUN 1"};
  }
  return {};
}

void VoltmeterAccelerometer::check_rate_against_integration() const {
  for (std::size_t i = 0; i < meters_.size(); ++i) {
    const double channels = wiring_ == Wiring::kOneScanner ? 3.0 : 1.0;
    const double zero = families_[i] == Family::kKeysightScanner ? kWithZero : 1.0;
    const double shortest_s = channels * zero * settings_.integration_plc / kFastLineHz;
    if (settings_.rate_hz * shortest_s <= 1.0) continue;
    meters_[i].fail(
        Fault::kRefused,
        fmt::format("rate_hz is {:g}; required: at most {:.3g}, because {:g} channel(s) with integration_plc "
                    "{:g}{} take {:.3g} s even at {:g} Hz mains",
                    settings_.rate_hz, rounded_down(1.0 / shortest_s), channels, settings_.integration_plc,
                    zero > 1.0 ? " and automatic zero" : "", shortest_s, kFastLineHz));
  }
}

void VoltmeterAccelerometer::start() {
  identify();
  check_rate_against_integration();
  for (std::size_t i = 0; i < meters_.size(); ++i) {
    Meter& meter = meters_[i];
    const bool keithley = families_[i] == Family::kKeithley2700 || families_[i] == Family::kKeithley2001;
    // On a serial line a Keysight voltmeter measures only under remote control; elsewhere it may call this an
    // error, which *CLS clears.
    if (!keithley) meter.send("SYST:REM");
    meter.send("*RST");
    std::vector<std::string> commands = setup(families_[i]);
    commands.insert(commands.begin(), "*CLS");
    meter.configure(commands);
    if (families_[i] == Family::kKeysightScanner) {
      std::vector<int> found = meter.scan_list();
      std::vector<int> wanted(settings_.channels.begin(), settings_.channels.end());
      std::sort(found.begin(), found.end());
      std::sort(wanted.begin(), wanted.end());
      if (found != wanted) {
        meter.fail(Fault::kImplausible, fmt::format("it reports that it scans {}; required: {}",
                                                    scpi::channel_list(found), scpi::channel_list(wanted)));
      }
    }
  }
  for (Meter& meter : meters_) meter.restart_figures();
  check_rate_by_trial();
  under_way_ = discard_scan_ = false;
  sequence_ = readings_ = lost_ = lost_in_a_row_ = 0;
  due_ = clock_.now();
  started_ = true;
}

/// Takes one scan to measure its true duration, because switching, settling and the line are not in any
/// computation. The first one may be slow for other reasons, so the rate is refused only if the mean of
/// further scans misses it as well.
void VoltmeterAccelerometer::check_rate_by_trial() {
  if (trial_scan_s() * settings_.rate_hz <= 1.0) return;
  double sum_s = 0.0;
  int scans = 0;
  while (scans < kTrialScans && sum_s < kLongestTrialS) {
    sum_s += trial_scan_s();
    ++scans;
  }
  const double mean_s = sum_s / scans;
  if (mean_s * settings_.rate_hz <= 1.0) return;
  meters_[0].fail(Fault::kRefused, fmt::format("rate_hz is {:g}; required: at most {:.3g}, because a scan "
                                               "takes {:.3g} s (mean of {}) with integration_plc {:g}",
                                               settings_.rate_hz, rounded_down(1.0 / mean_s), mean_s, scans,
                                               settings_.integration_plc));
}

/// How long one scan takes.
double VoltmeterAccelerometer::trial_scan_s() {
  const Clock::Instant begin = clock_.now();
  begin_scans();
  while (!collect(clock_.now() + kScanMargin))
    continue;  // Each meter has a deadline and reports why it failed.
  Clock::Instant end = begin;
  for (std::size_t i = 0; i < meters_.size(); ++i) {
    const scpi::ScanOutcome& outcome = *outcomes_[i];
    if (outcome.readings.empty()) meters_[i].fail(outcome.fault, outcome.complaint);
    end = std::max(end, outcome.arrival);
  }
  return to_seconds(end - begin);
}

void VoltmeterAccelerometer::begin_scans() {
  for (auto& outcome : outcomes_) outcome.reset();
  for (Meter& meter : meters_) meter.begin_scan();
}

/// Waits for the scan of every voltmeter to end. False: one has not by the deadline.
bool VoltmeterAccelerometer::collect(Clock::Instant deadline) {
  bool all = true;
  for (std::size_t i = 0; i < meters_.size(); ++i) {
    if (!outcomes_[i]) outcomes_[i] = meters_[i].await_scan(deadline);
    all = all && outcomes_[i].has_value();
  }
  return all;
}

/// The voltmeter whose part of the scan is lost, if any.
std::optional<std::size_t> VoltmeterAccelerometer::loser() const {
  for (std::size_t i = 0; i < outcomes_.size(); ++i)
    if (outcomes_[i]->readings.empty()) return i;
  return std::nullopt;
}

Reading VoltmeterAccelerometer::make_reading() const {
  Reading reading;
  std::size_t axis = 0;
  for (const auto& outcome : outcomes_) {
    reading.arrival = std::max(reading.arrival, outcome->arrival);
    for (const scpi::ChannelReading& channel : outcome->readings) {
      const double volts = channel.overload != 0 ? channel.overload * settings_.range_v : channel.volts;
      reading.over_range = reading.over_range || channel.overload != 0;
      reading.output(static_cast<Eigen::Index>(axis)) =
          (volts - settings_.bias[axis]) / settings_.scale[axis];
      ++axis;
    }
  }
  return reading;
}

std::optional<Reading> VoltmeterAccelerometer::next(Clock::Instant deadline) {
  if (!started_) meters_[0].fail(Fault::kNotReady, "asked for a reading before it was started");
  const Clock::Duration period = from_seconds(1.0 / settings_.rate_hz);
  for (;;) {
    if (!under_way_) {
      if (clock_.now() < due_) clock_.sleep_until(std::min(due_, deadline));
      if (clock_.now() < due_) return std::nullopt;
      const Clock::Instant now = clock_.now();
      due_ = (now - due_ < period ? due_ : now) + period;  // Missed scans are not made up for.
      begin_scans();
      under_way_ = true;
    }
    if (!collect(deadline)) return std::nullopt;
    under_way_ = false;
    const bool discard = std::exchange(discard_scan_, false);
    const std::uint64_t sequence = sequence_++;
    if (const auto i = loser()) {
      ++lost_;
      if (++lost_in_a_row_ >= kMostLostInARow) {
        lost_in_a_row_ = 0;
        meters_[*i].fail(outcomes_[*i]->fault, fmt::format("{} scans in a row are lost; the last: {}",
                                                           kMostLostInARow, outcomes_[*i]->complaint));
      }
      continue;
    }
    lost_in_a_row_ = 0;
    if (discard) continue;
    ++readings_;
    Reading reading = make_reading();
    reading.sequence = sequence;
    return reading;
  }
}

void VoltmeterAccelerometer::discard_pending() {
  discard_scan_ = under_way_;
}

StreamHealth VoltmeterAccelerometer::health() const {
  StreamHealth health{.readings = readings_, .lost_readings = lost_};
  for (const Meter& meter : meters_) {
    health.bad_frames += meter.bad_frames();
    health.skipped_bytes += meter.skipped_bytes();
  }
  return health;
}

void VoltmeterAccelerometer::stop() noexcept {
  for (std::size_t i = 0; i < families_.size(); ++i) {
    switch (families_[i]) {
      case Family::kKeysightScanner:
        meters_[i].leave({"ABOR", "SYST:LOC"});
        break;
      case Family::kKeithley2700:
      case Family::kKeithley2001:
        meters_[i].leave({":ABOR"});
        break;
      case Family::kSingle:  // The 34401A has no command to abort; it goes local when its one reading is
                             // made.
        meters_[i].leave({"SYST:LOC"});
        break;
    }
  }
  started_ = false;
}

}  // namespace abcal
