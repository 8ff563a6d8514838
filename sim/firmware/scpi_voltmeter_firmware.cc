#include "sim/firmware/scpi_voltmeter_firmware.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <deque>
#include <limits>
#include <map>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "drivers/text/names.h"
#include "drivers/text/text.h"
#include "sim/firmware/reply_queue.h"
#include "sim/firmware/scpi_status.h"

namespace abcal::sim {
namespace {

// Errors of SCPI 1999, volume 2, chapter 21.
constexpr int kParameterNotAllowed = -108;
constexpr int kMissingParameter = -109;
constexpr int kUndefinedHeader = -113;
constexpr int kInvalidSuffix = -131;
constexpr int kInitIgnored = -213;
constexpr int kDataOutOfRange = -222;
constexpr int kTooMuchData = -223;
constexpr int kIllegalParameter = -224;
constexpr int kDataStale = -230;
constexpr int kQueueOverflow = -350;
constexpr int kLocalLockout = 550;  // 34401A: command not allowed in local.

constexpr std::size_t kErrorMemory = 20;
constexpr std::size_t kLongestMessage = 4096;
constexpr std::size_t kMostReadings = 50000;
constexpr double kOverload = 9.9e37;
constexpr double kOverRange = 1.2;  // A range goes to 120 % of its name, the highest one excepted.
constexpr std::array kRanges{0.1, 1.0, 10.0, 100.0, 300.0};
constexpr std::array kKeysightNplc{0.02, 0.2, 1.0, 2.0, 10.0, 20.0, 100.0, 200.0};
constexpr int kChannelsOfACard = 20;

// Bits of the status registers (docs/protocols/scpi_voltmeters.md).
constexpr unsigned kMeasuring = 1U << 4U;         // OPERation
constexpr unsigned kKeithleyIdle = 1U << 10U;     // OPERation
constexpr unsigned kVoltageOverload = 1U << 0U;   // QUEStionable
constexpr unsigned kReadingAvailable = 1U << 5U;  // MEASurement
constexpr unsigned kBufferFull = 1U << 9U;        // MEASurement

struct Model {
  std::string_view name;
  ScpiFamily family;
  std::string_view identity;  ///< "{}" is replaced by the serial number.
  ScpiStatusLayout layout;
};
constexpr ScpiStatusLayout kOldScanner{.alarm = 1U << 1U};
constexpr ScpiStatusLayout kNewScanner{.error_queue = 1U << 2U, .alarm = 1U << 1U};
constexpr ScpiStatusLayout kOldMeter{.operation = 0};
constexpr ScpiStatusLayout kNewMeter{.error_queue = 1U << 2U};
constexpr ScpiStatusLayout kKeithleyByte{.error_queue = 1U << 2U, .measurement = 1U << 0U};
// The layouts of DAQ970A, 34460A, 34461A, 34470A, 2000, 2701 and 2750 equal those of their sisters
// [unverified against a device].
constexpr auto kModels = std::to_array<Model>({
    {"34970A", ScpiFamily::kKeysight34970a, "HEWLETT-PACKARD,34970A,{},13-2-2", kOldScanner},
    {"34972A", ScpiFamily::kKeysight34970a, "Agilent Technologies,34972A,{},1.16-1.12-02-02", kOldScanner},
    {"DAQ970A", ScpiFamily::kKeysight34970a,
     "Keysight Technologies,DAQ970A,{},A.02.02-01.00-02.01-00.02-03-02", kNewScanner},
    {"34401A", ScpiFamily::kKeysight34401a, "HEWLETT-PACKARD,34401A,0,11-5-2", kOldMeter},
    {"34460A", ScpiFamily::kKeysight34401a, "Keysight Technologies,34460A,{},A.03.01-03.15-03.01-00.52-03-02",
     kNewMeter},
    {"34461A", ScpiFamily::kKeysight34401a, "Keysight Technologies,34461A,{},A.03.01-03.15-03.01-00.52-03-02",
     kNewMeter},
    {"34465A", ScpiFamily::kKeysight34401a, "Keysight Technologies,34465A,{},A.03.01-03.15-03.01-00.52-03-02",
     kNewMeter},
    {"34470A", ScpiFamily::kKeysight34401a, "Keysight Technologies,34470A,{},A.03.01-03.15-03.01-00.52-03-02",
     kNewMeter},
    {"2000", ScpiFamily::kKeithley2700, "KEITHLEY INSTRUMENTS INC.,MODEL 2000,{},A20  /A02  ", kKeithleyByte},
    {"2001", ScpiFamily::kKeithley2700, "KEITHLEY INSTRUMENTS INC.,MODEL 2001,{},B17  /A02  ", kKeithleyByte},
    {"2700", ScpiFamily::kKeithley2700, "KEITHLEY INSTRUMENTS INC.,MODEL 2700,{},B09  /A02  ", kKeithleyByte},
    {"2701", ScpiFamily::kKeithley2700, "KEITHLEY INSTRUMENTS INC.,MODEL 2701,{},A01  /A02  ", kKeithleyByte},
    {"2750", ScpiFamily::kKeithley2700, "KEITHLEY INSTRUMENTS INC.,MODEL 2750,{},A01  /A02  ", kKeithleyByte},
});

constexpr auto kDefaultModels =
    names<ScpiFamily>({{ScpiFamily::kKeysight34970a, "34970A"}, {ScpiFamily::kKeysight34401a, "34465A"}});

/// @throws std::invalid_argument
const Model& model_named(std::string_view name) {
  const auto found =
      std::find_if(kModels.begin(), kModels.end(), [name](const Model& model) { return model.name == name; });
  if (found != kModels.end()) return *found;
  std::string known;
  for (const Model& model : kModels) known += fmt::format("{}{}", known.empty() ? "" : ", ", model.name);
  throw std::invalid_argument(
      fmt::format("simulated SCPI voltmeter: model is \"{}\", required: one of {}", name, known));
}

constexpr auto kErrorTexts = names<int>({{0, "No error"},
                                         {kParameterNotAllowed, "Parameter not allowed"},
                                         {kMissingParameter, "Missing parameter"},
                                         {kUndefinedHeader, "Undefined header"},
                                         {kInvalidSuffix, "Invalid suffix"},
                                         {kInitIgnored, "Init ignored"},
                                         {kDataOutOfRange, "Data out of range"},
                                         {kTooMuchData, "Too much data"},
                                         {kIllegalParameter, "Illegal parameter value"},
                                         {kDataStale, "Data stale"},
                                         {kQueueOverflow, "Queue overflow"},
                                         {kLocalLockout, "Command not allowed in local"}});

/// Thrown by a command that is refused; ends up in the error queue.
struct Refusal {
  int code;
};

char upper(char c) {
  return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
}
std::string upper(std::string_view text) {
  std::string result(text);
  for (char& c : result) c = upper(c);
  return result;
}
/// Splits at `separator` outside of quotes and parentheses.
std::vector<std::string> split(std::string_view text, char separator) {
  std::vector<std::string> parts;
  std::string part;
  int depth = 0;
  char quote = 0;
  for (const char c : text) {
    if (quote == 0 && (c == '"' || c == '\'')) {
      quote = c;
    } else if (c == quote) {
      quote = 0;
    }
    const bool quoted = quote != 0;
    if (!quoted && c == '(') ++depth;
    if (!quoted && c == ')') --depth;
    if (c == separator && !quoted && depth == 0) {
      parts.emplace_back(pieces::trimmed(part));
      part.clear();
    } else {
      part.push_back(c);
    }
  }
  parts.emplace_back(pieces::trimmed(part));
  return parts;
}

/// The forms of one command: nodes with their short form in capitals, optional ones in brackets, '?' for a
/// query. True if `header` (upper case, no leading colon) is one of them.
bool matches(std::string_view pattern, std::string_view header) {
  if (pattern.empty()) return header.empty();
  if (pattern.front() == '[') {
    const std::size_t end = pattern.find(']');
    const std::string_view optional = pattern.substr(1, end - 1);
    const std::string_view rest = pattern.substr(end + 1);
    return matches(std::string(optional) + std::string(rest), header) || matches(rest, header);
  }
  if (pattern.front() == ':') {
    // The first node of a header has no colon before it.
    if (!header.empty() && header.front() == ':') return matches(pattern.substr(1), header.substr(1));
    return false;
  }
  if (pattern == "?") return header == "?";
  const std::size_t pattern_end = std::min(pattern.find_first_of(":[?"), pattern.size());
  const std::size_t header_end = std::min(header.find_first_of(":?"), header.size());
  const std::string_view node = pattern.substr(0, pattern_end);
  const std::string_view word = header.substr(0, header_end);
  std::string short_form(node);  // "LAYer2": LAY2
  std::erase_if(short_form, [](char c) { return c >= 'a' && c <= 'z'; });
  if (word != short_form && word != upper(node)) return false;
  return matches(pattern.substr(pattern_end), header.substr(header_end));
}

double number(std::string_view text) {
  if (text.starts_with('+')) text.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{}) throw Refusal{kIllegalParameter};
  if (end != text.data() + text.size()) throw Refusal{kInvalidSuffix};
  return value;
}

bool boolean(std::string_view text) {
  const std::string word = upper(text);
  if (word == "ON" || word == "1") return true;
  if (word == "OFF" || word == "0" || word == "ONCE") return false;
  throw Refusal{kIllegalParameter};
}

}  // namespace

class ScpiVoltmeterFirmware::Meter final : public Firmware {
 public:
  Meter(std::shared_ptr<SimBench> bench, ScpiVoltmeterSettings settings, UnservedCommands& unserved);

  void receive(std::string_view bytes, Clock::Instant now) override;
  void session_starts() override {
    input_.clear();
    waiting_.clear();
    replies_.clear();
  }
  std::string transmit(Clock::Instant now) override;
  std::optional<Clock::Instant> next_due() const override;
  void power(bool on, Clock::Instant now) override;
  std::optional<unsigned> line_speed() const override { return settings_.baud; }

 private:
  struct Command {
    std::string_view pattern;
    std::optional<std::string> (Meter::*run)(const std::vector<std::string>& arguments);
    unsigned families = kAll;
  };
  enum class Kind { kBoolean, kNumber, kWhole, kWord, kText };
  /// A setting that is kept, read back by its query, and changes nothing.
  struct KeptSetting {
    std::string_view pattern;
    Kind kind;
    std::string_view initial;
    unsigned families = kAll;
  };
  enum : unsigned {
    kScanner = 1,
    kSingle = 2,  ///< But a 34401A.
    kOldSingle = 4,
    kSingles = kSingle | kOldSingle,
    kKeysight = kScanner | kSingles,
    k2700 = 8,  ///< And 2000.
    k2001 = 16,
    kKeithley = k2700 | k2001,
    kWithOperation = kScanner | kSingle | kKeithley,
    kAll = 31
  };

  struct Sample {
    double value;
    int channel;
    Clock::Instant time;
  };
  using Arguments = std::vector<std::string>;
  using Reply = std::optional<std::string>;

  static const std::vector<Command>& commands();
  static const std::vector<KeptSetting>& kept_settings();
  const KeptSetting* kept_setting(std::string_view header) const;
  Reply keep(const KeptSetting& setting, const Arguments& a);
  std::string kept(const KeptSetting& setting) const;

  void power_on();
  void run_message(const std::string& message);
  Reply run_command(std::string header, std::string_view arguments, std::string& path);
  void run_waiting(Clock::Instant now);
  void remember(int code);
  void settle();

  // Settings.
  unsigned family() const;
  bool is_2001() const { return settings_.model == "2001"; }
  std::string integer(unsigned value) const { return fmt::format("{}{}", keithley() ? "" : "+", value); }
  bool keithley() const { return settings_.family == ScpiFamily::kKeithley2700; }
  bool single() const { return settings_.family == ScpiFamily::kKeysight34401a; }
  bool is_channel(int channel) const;
  std::vector<int> channel_list(std::string_view text) const;
  std::optional<std::vector<int>> take_channel_list(Arguments& a) const;
  void set_range(std::string_view text);
  void set_resolution(std::string_view text);
  void set_nplc(std::string_view text);
  double number_or_limit(std::string_view text, double lowest, double highest) const;

  // Measurement.
  Clock::Duration channel_time() const;
  std::vector<int> scanned() const;
  void check_remote() const;
  void begin_measurement();
  double measure(int channel, Clock::Instant t, std::uint64_t index, Clock::Duration period) const;
  std::string readings() const;
  std::string text_of_sample(const Sample& sample, std::size_t index) const;

  // Commands.
  Reply idn(const Arguments&);
  Reply rst(const Arguments&);
  Reply cls(const Arguments&);
  Reply opc(const Arguments&);
  Reply ask_opc(const Arguments&);
  Reply wait(const Arguments&);
  Reply nothing(const Arguments&) { return std::nullopt; }
  Reply zero(const Arguments&) { return integer(0); }
  static unsigned register_value(const Arguments& a, unsigned largest);
  Reply event_enable(const Arguments& a);
  Reply ask_event_enable(const Arguments&) { return integer(status_.standard_enable); }
  Reply service_enable(const Arguments& a);
  Reply ask_service_enable(const Arguments&) { return integer(status_.service_enable); }
  Reply ask_events(const Arguments&) { return integer(status_.take_standard()); }
  Reply ask_status_byte(const Arguments&) {
    return integer(status_.status_byte(!errors_.empty(), replies_.next_due().has_value()));
  }
  Reply preset(const Arguments&);
  template <ScpiStatus::Group group>
  Reply ask_group(const Arguments&) {
    return integer(status_.take_event(group));
  }
  template <ScpiStatus::Group group>
  Reply ask_condition(const Arguments&) {
    return integer(group == ScpiStatus::kOperation ? operation_condition() : 0U);
  }
  template <ScpiStatus::Group group>
  Reply group_enable(const Arguments& a) {
    status_.enable(group) = register_value(a, 65535);
    return std::nullopt;
  }
  template <ScpiStatus::Group group>
  Reply ask_group_enable(const Arguments&) {
    return integer(status_.enable(group));
  }
  unsigned operation_condition() const;
  Reply clear_errors(const Arguments&);
  Reply options(const Arguments&) {
    return settings_.model == "2001" || settings_.model == "2000" ? "0" : "7700,NONE";
  }
  Reply relay_counts(const Arguments& a);
  Reply three_zeros(const Arguments&) { return "+0,+0,+0"; }
  Reply close_channel(const Arguments& a);
  Reply open_channels(const Arguments&);
  Reply arm_count(const Arguments& a);
  Reply ask_arm_count(const Arguments&) { return fmt::format("{}", arm_count_); }
  Reply immediate(const Arguments&) { return "IMM"; }
  Reply stored(const Arguments&);
  Reply ask_date(const Arguments&) { return "+2026,+1,+1"; }
  Reply ask_time(const Arguments&) { return "+0,+0,+0.000"; }
  Reply ask_error(const Arguments&);
  Reply ask_version(const Arguments&) { return "1994.0"; }
  Reply remote(const Arguments&);
  Reply local(const Arguments&);
  Reply configure(const Arguments& a);
  Reply ask_configure(const Arguments& a);
  Reply measure_once(const Arguments& a);
  Reply function(const Arguments& a);
  Reply ask_function(const Arguments&) { return single() || !keithley() ? "\"VOLT\"" : "\"VOLT:DC\""; }
  Reply nplc(const Arguments& a);
  Reply ask_nplc(const Arguments& a);
  Reply range(const Arguments& a);
  Reply ask_range(const Arguments&);
  Reply range_auto(const Arguments& a);
  Reply ask_range_auto(const Arguments&);
  Reply resolution(const Arguments& a);
  Reply zero_auto(const Arguments& a);
  Reply ask_zero_auto(const Arguments& a);
  Reply scan(const Arguments& a);
  Reply ask_scan(const Arguments& a);
  Reply ask_scan_size(const Arguments&) { return fmt::format("+{}", scan_list_.size()); }
  Reply scan_select(const Arguments& a);
  Reply trigger_source(const Arguments& a);
  Reply ask_trigger_source(const Arguments&) { return trigger_source_; }
  Reply trigger_count(const Arguments& a);
  Reply ask_trigger_count(const Arguments&) {
    if (keithley()) return fmt::format("{}", trigger_count_);
    return fmt::format("{:+.8E}", static_cast<double>(trigger_count_));
  }
  Reply sample_count(const Arguments& a);
  Reply ask_sample_count(const Arguments&) { return fmt::format("+{}", sample_count_); }
  Reply delay(const Arguments& a);
  Reply ask_delay(const Arguments&) { return fmt::format("{:+.8E}", channel_delay_s_); }
  double resolution_of_range() const;
  Reply ask_resolution(const Arguments&) { return fmt::format("{:+.8E}", resolution_of_range()); }
  Reply terminals(const Arguments&) { return "FRON"; }
  Reply clear_text(const Arguments&);
  Reply ask_closed(const Arguments&);
  Reply ask_closed_states(const Arguments& a);
  Reply ask_with_channel(const Arguments&) { return with_channel_ ? "1" : "0"; }
  Reply ask_with_unit(const Arguments&) { return with_unit_ ? "1" : "0"; }
  Reply ask_with_time(const Arguments&) { return with_time_ ? "1" : "0"; }
  Reply ask_continuous(const Arguments&) { return continuous_ ? "1" : "0"; }
  Reply ask_format(const Arguments&) { return "ASC"; }
  Reply with_channel(const Arguments& a);
  Reply with_unit(const Arguments& a);
  Reply with_time(const Arguments& a);
  Reply elements(const Arguments& a);
  Reply initiate(const Arguments&);
  Reply initiate_continuous(const Arguments& a);
  Reply fetch(const Arguments&);
  Reply read(const Arguments&);
  Reply abort(const Arguments&);
  Reply card(const Arguments& a);
  Reply points(const Arguments&);

  std::shared_ptr<SimBench> bench_;
  ScpiVoltmeterSettings settings_;

  // Settings after *RST.
  double range_ = 0.0;  ///< 0: automatic.
  double nplc_ = 1.0;
  bool auto_zero_ = true;
  std::vector<int> scan_list_;
  bool scans_ = false;  ///< Keithley: ROUT:SCAN:LSEL INT; without, one channel is measured.
  std::string trigger_source_ = "IMM";
  std::size_t trigger_count_ = 1;
  std::size_t sample_count_ = 1;
  std::size_t arm_count_ = 1;  ///< 2001: how many channels of the list.
  int closed_channel_ = 0;     ///< Keithley: measured while it does not scan; 0: the front input.
  double channel_delay_s_ = 0.0;
  std::map<std::string_view, std::string> kept_;  ///< By the pattern of kept_settings().
  bool with_channel_ = false;
  bool with_unit_ = false;
  bool with_time_ = false;
  bool with_number_ = false;
  bool continuous_ = false;

  bool remote_ = false;
  UnservedCommands& unserved_;
  ScpiStatusLayout layout_;
  ScpiStatus status_;
  bool tells_completion_ = false;  ///< After *OPC.
  bool measuring_ = false;         ///< A measurement has begun whose end has not been seen yet.
  std::deque<int> errors_;
  std::vector<Sample> samples_;
  bool has_samples_ = false;
  Clock::Instant measured_until_;  ///< When the measurement begun last ends.
  std::uint64_t scans_made_ = 0;

  ReplyQueue replies_;
  std::string input_;
  std::deque<std::string> waiting_;           ///< Messages that arrived while one was being carried out.
  std::optional<Clock::Instant> busy_until_;  ///< READ?, FETC?, *OPC? hold the messages behind them.
  Clock::Instant now_;
};

ScpiVoltmeterFirmware::Meter::Meter(std::shared_ptr<SimBench> bench, ScpiVoltmeterSettings settings,
                                    UnservedCommands& unserved)
    : bench_(std::move(bench)),
      settings_(std::move(settings)),
      unserved_(unserved),
      measured_until_(bench_->start()),
      now_(bench_->start()) {
  if (settings_.model.empty()) settings_.model = kDefaultModels.of(settings_.family, "2700");
  const Model& model = model_named(settings_.model);
  const auto refuse = [](const std::string& what) {
    throw std::invalid_argument("simulated SCPI voltmeter: " + what);
  };
  if (settings_.single_channel > 2)
    refuse(fmt::format("single_channel is {}, required: 0, 1 or 2", settings_.single_channel));
  if (!(settings_.line_frequency_hz > 0.0))
    refuse(fmt::format("line_frequency_hz is {}, required: a positive number", settings_.line_frequency_hz));
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < i; ++j)
      if (settings_.channels[i] == settings_.channels[j])
        refuse(fmt::format("channel {} is given twice", settings_.channels[i]));
  if (model.family != settings_.family) refuse(fmt::format("model {} is of another family", settings_.model));
  status_ = ScpiStatus(model.layout);
  if (settings_.identity.empty()) {
    settings_.identity = model.identity;
    if (const std::size_t hole = settings_.identity.find("{}"); hole != std::string::npos)
      settings_.identity.replace(hole, 2, settings_.serial_number);
  }
  layout_ = model.layout;
  power_on();
}

/// Returns to the settings of *RST and clears everything but the bit that reports power-on.
void ScpiVoltmeterFirmware::Meter::power(bool on, Clock::Instant now) {
  now_ = now;
  measured_until_ = std::min(measured_until_, now);
  session_starts();
  busy_until_.reset();
  if (!on) return;
  errors_.clear();
  status_ = ScpiStatus(layout_);
  power_on();
}

void ScpiVoltmeterFirmware::Meter::power_on() {
  range_ = 0.0;
  nplc_ = 1.0;
  auto_zero_ = true;
  scan_list_.clear();
  scans_ = false;
  trigger_source_ = "IMM";
  trigger_count_ = sample_count_ = arm_count_ = 1;
  closed_channel_ = 0;
  tells_completion_ = measuring_ = false;
  channel_delay_s_ = 0.0;
  with_channel_ = with_time_ = with_unit_ = with_number_ = false;
  if (keithley()) with_unit_ = with_time_ = with_number_ = true;  // READ, UNIT, TST, RNUM
  kept_.clear();
  continuous_ = false;
  has_samples_ = false;
  samples_.clear();
}

unsigned ScpiVoltmeterFirmware::Meter::family() const {
  switch (settings_.family) {
    case ScpiFamily::kKeysight34970a:
      return kScanner;
    case ScpiFamily::kKeysight34401a:
      return settings_.model == "34401A" ? kOldSingle : kSingle;
    default:
      return is_2001() ? k2001 : k2700;
  }
}

// A table of names. NOLINTNEXTLINE(readability-function-size)
const std::vector<ScpiVoltmeterFirmware::Meter::Command>& ScpiVoltmeterFirmware::Meter::commands() {
  using M = Meter;
  static const std::vector<Command> table{
      {"*IDN?", &M::idn},
      {"*RST", &M::rst},
      {"*CLS", &M::cls},
      {"*OPC", &M::opc},
      {"*OPC?", &M::ask_opc},
      {"*WAI", &M::wait},
      {"*ESE", &M::event_enable},
      {"*ESE?", &M::ask_event_enable},
      {"*SRE", &M::service_enable},
      {"*SRE?", &M::ask_service_enable},
      {"*ESR?", &M::ask_events},
      {"*STB?", &M::ask_status_byte},
      {"*TST?", &M::zero},
      {"*OPT?", &M::options, kKeithley},
      {"*PSC", &M::nothing},
      {"*PSC?", &M::zero},
      {"SYSTem:ERRor[:NEXT]?", &M::ask_error},
      {"SYSTem:VERSion?", &M::ask_version},
      {"SYSTem:REMote", &M::remote},
      {"SYSTem:RWLock", &M::remote},
      {"SYSTem:LOCal", &M::local},
      {"SYSTem:PRESet", &M::rst},
      {"SYSTem:BEEPer[:IMMediate]", &M::nothing},
      {"SYSTem:CTYPe?", &M::card, kScanner},
      {"SYSTem:DATE", &M::nothing},
      {"SYSTem:DATE?", &M::ask_date},
      {"SYSTem:TIME", &M::nothing},
      {"SYSTem:TIME?", &M::ask_time},
      {"SYSTem:CLEar", &M::clear_errors, kKeithley},
      {"DISPlay:TEXT:CLEar", &M::clear_text},
      {"DIAGnostic:DMM:CYCLes?", &M::three_zeros, kScanner},
      {"DIAGnostic:RELay:CYCLes?", &M::relay_counts, kScanner},
      {"DIAGnostic:PEEK:SLOT:DATA?", &M::three_zeros, kScanner},
      {"STATus:PRESet", &M::preset},
      {"STATus:QUEue[:NEXT]?", &M::ask_error, kKeithley},
      {"STATus:QUEue:CLEar", &M::clear_errors, kKeithley},
      {"STATus:OPERation:CONDition?", &M::ask_condition<ScpiStatus::kOperation>, kWithOperation},
      {"STATus:OPERation[:EVENt]?", &M::ask_group<ScpiStatus::kOperation>, kWithOperation},
      {"STATus:OPERation:ENABle", &M::group_enable<ScpiStatus::kOperation>, kWithOperation},
      {"STATus:OPERation:ENABle?", &M::ask_group_enable<ScpiStatus::kOperation>, kWithOperation},
      {"STATus:QUEStionable:CONDition?", &M::ask_condition<ScpiStatus::kQuestionable>},
      {"STATus:QUEStionable[:EVENt]?", &M::ask_group<ScpiStatus::kQuestionable>},
      {"STATus:QUEStionable:ENABle", &M::group_enable<ScpiStatus::kQuestionable>},
      {"STATus:QUEStionable:ENABle?", &M::ask_group_enable<ScpiStatus::kQuestionable>},
      {"STATus:ALARm:CONDition?", &M::ask_condition<ScpiStatus::kAlarm>, kScanner},
      {"STATus:ALARm[:EVENt]?", &M::ask_group<ScpiStatus::kAlarm>, kScanner},
      {"STATus:ALARm:ENABle", &M::group_enable<ScpiStatus::kAlarm>, kScanner},
      {"STATus:ALARm:ENABle?", &M::ask_group_enable<ScpiStatus::kAlarm>, kScanner},
      {"STATus:MEASurement:CONDition?", &M::ask_condition<ScpiStatus::kMeasurement>, kKeithley},
      {"STATus:MEASurement[:EVENt]?", &M::ask_group<ScpiStatus::kMeasurement>, kKeithley},
      {"STATus:MEASurement:ENABle", &M::group_enable<ScpiStatus::kMeasurement>, kKeithley},
      {"STATus:MEASurement:ENABle?", &M::ask_group_enable<ScpiStatus::kMeasurement>, kKeithley},
      {"CONFigure[:VOLTage][:DC]", &M::configure},
      {"CONFigure?", &M::ask_configure},
      {"MEASure[:VOLTage][:DC]?", &M::measure_once},
      {"[SENSe:]FUNCtion[:ON]", &M::function},
      {"[SENSe:]FUNCtion?", &M::ask_function},
      {"[SENSe:]VOLTage[:DC]:NPLCycles", &M::nplc},
      {"[SENSe:]VOLTage[:DC]:NPLCycles?", &M::ask_nplc},
      {"[SENSe:]VOLTage[:DC]:RANGe[:UPPer]", &M::range},
      {"[SENSe:]VOLTage[:DC]:RANGe[:UPPer]?", &M::ask_range},
      {"[SENSe:]VOLTage[:DC]:RANGe:AUTO", &M::range_auto},
      {"[SENSe:]VOLTage[:DC]:RANGe:AUTO?", &M::ask_range_auto},
      {"[SENSe:]VOLTage[:DC]:RESolution", &M::resolution, kKeysight},
      {"[SENSe:]VOLTage[:DC]:RESolution?", &M::ask_resolution, kKeysight},
      {"[SENSe:]VOLTage[:DC]:ZERO:AUTO", &M::zero_auto, kKeysight},
      {"[SENSe:]VOLTage[:DC]:ZERO:AUTO?", &M::ask_zero_auto, kKeysight},
      {"[SENSe:]ZERO:AUTO", &M::zero_auto, kKeysight},
      {"[SENSe:]ZERO:AUTO?", &M::ask_zero_auto, kKeysight},
      {"SYSTem:AZERo[:STATe]", &M::zero_auto, kKeithley},
      {"SYSTem:AZERo[:STATe]?", &M::ask_zero_auto, kKeithley},
      {"ROUTe:SCAN[:INTernal]", &M::scan, kScanner | kKeithley},
      {"ROUTe:SCAN[:INTernal]?", &M::ask_scan, kScanner | kKeithley},
      {"ROUTe:SCAN:SIZE?", &M::ask_scan_size, kScanner},
      {"ROUTe:SCAN:LSELect", &M::scan_select, kKeithley},
      {"ROUTe:CHANnel:DELay", &M::delay, kScanner},
      {"ROUTe:CHANnel:DELay?", &M::ask_delay, kScanner},
      {"ROUTe:TERMinals?", &M::terminals, kSingles},
      {"TRIGger[:SEQuence]:DELay", &M::delay},
      {"TRIGger[:SEQuence]:DELay?", &M::ask_delay},
      {"TRIGger[:SEQuence]:SOURce", &M::trigger_source},
      {"TRIGger[:SEQuence]:SOURce?", &M::ask_trigger_source},
      {"TRIGger[:SEQuence]:COUNt", &M::trigger_count},
      {"TRIGger[:SEQuence]:COUNt?", &M::ask_trigger_count},
      {"SAMPle:COUNt", &M::sample_count, kSingles | k2700},
      {"SAMPle:COUNt?", &M::ask_sample_count, kSingles | k2700},
      {"ARM:LAYer2:COUNt", &M::arm_count, k2001},
      {"ARM:LAYer2:COUNt?", &M::ask_arm_count, k2001},
      {"ARM:LAYer2:SOURce", &M::trigger_source, k2001},
      {"ARM:LAYer2:SOURce?", &M::immediate, k2001},
      {"ROUTe:CLOSe", &M::close_channel, kKeithley},
      {"ROUTe:MULTiple:CLOSe", &M::close_channel, kKeithley},
      {"ROUTe:CLOSe?", &M::ask_closed, kKeithley},
      {"ROUTe:MULTiple:CLOSe?", &M::ask_closed, kKeithley},
      {"ROUTe:CLOSe:STATe?", &M::ask_closed_states, kKeithley},
      {"ROUTe:MULTiple:STATe?", &M::ask_closed_states, kKeithley},
      {"ROUTe:OPEN", &M::open_channels, kKeithley},
      {"ROUTe:MULTiple:OPEN", &M::open_channels, kKeithley},
      {"ROUTe:OPEN:ALL", &M::open_channels, kKeithley},
      {"ROUTe:MULTiple:OPEN:ALL", &M::open_channels, kKeithley},
      {"FORMat:READing:CHANnel", &M::with_channel, kScanner},
      {"FORMat:READing:UNIT", &M::with_unit, kScanner},
      {"FORMat:READing:TIME", &M::with_time, kScanner},
      {"FORMat:READing:CHANnel?", &M::ask_with_channel, kScanner},
      {"FORMat:READing:UNIT?", &M::ask_with_unit, kScanner},
      {"FORMat:READing:TIME?", &M::ask_with_time, kScanner},
      {"FORMat:ELEMents", &M::elements, kKeithley},
      {"FORMat[:DATA]", &M::nothing},
      {"FORMat[:DATA]?", &M::ask_format},
      {"INITiate[:IMMediate]", &M::initiate},
      {"INITiate:CONTinuous", &M::initiate_continuous, kKeithley},
      {"INITiate:CONTinuous?", &M::ask_continuous, kKeithley},
      {"FETCh?", &M::fetch},
      {"READ?", &M::read},
      {"ABORt", &M::abort},
      {"DATA:POINts?", &M::points},
      {"TRACe:CLEar", &M::nothing, kKeithley},
      {"TRACe:POINts", &M::nothing, kKeithley},
      {"TRACe:POINts?", &M::points, kKeithley},
      {"TRACe:DATA?", &M::stored, kKeithley},
      {"DATA:CLEar", &M::nothing, kKeithley},
      {"DATA:POINts", &M::nothing, kKeithley},
      {"DATA:DATA?", &M::stored, kKeithley},
      {"DATA[:LATest]?", &M::stored, kKeithley},
  };
  return table;
}

// Initial values: [unverified against a device].
const std::vector<ScpiVoltmeterFirmware::Meter::KeptSetting>& ScpiVoltmeterFirmware::Meter::kept_settings() {
  static const std::vector<KeptSetting> table{
      {"SYSTem:BEEPer:STATe", Kind::kBoolean, "1"},
      {"DISPlay[:STATe]", Kind::kBoolean, "1", kKeysight},
      {"DISPlay:ENABle", Kind::kBoolean, "1"},
      {"DISPlay:TEXT[:DATA]", Kind::kText, ""},
      {"DISPlay:TEXT:STATe", Kind::kBoolean, "0", kKeithley},
      {"[SENSe:]VOLTage[:DC]:AVERage[:STATe]", Kind::kBoolean, "0", kKeithley},
      {"[SENSe:]VOLTage[:DC]:AVERage:COUNt", Kind::kWhole, "10", kKeithley},
      {"[SENSe:]VOLTage[:DC]:AVERage:TCONtrol", Kind::kWord, "REP", kKeithley},
      {"[SENSe:]VOLTage[:DC]:DIGits", Kind::kWhole, "7", kKeithley},
      {"[SENSe:]VOLTage[:DC]:REFerence", Kind::kNumber, "0", kKeithley},
      {"[SENSe:]VOLTage[:DC]:REFerence:STATe", Kind::kBoolean, "0", kKeithley},
      {"[SENSe:]DETector:BANDwidth", Kind::kNumber, "20", kSingles},
      {"INPut:IMPedance:AUTO", Kind::kBoolean, "0", kKeysight},
      {"TRIGger[:SEQuence]:DELay:AUTO", Kind::kBoolean, "1"},
      {"FORMat:READing:ALARm", Kind::kBoolean, "0", kScanner},
      {"FORMat:BORDer", Kind::kWord, "NORM"},
      {"TRACe:FEED", Kind::kWord, "SENS1", kKeithley},
      {"TRACe:FEED:CONTrol", Kind::kWord, "NEV", kKeithley},
      {"TRACe:EGRoup", Kind::kWord, "FULL", k2001},
      {"DATA:FEED", Kind::kWord, "SENS1", kKeithley},
      {"DATA:FEED:CONTrol", Kind::kWord, "NEV", kKeithley},
      {"DATA:EGRoup", Kind::kWord, "FULL", k2001},
  };
  return table;
}

/// The setting that a header sets or, ending in a question mark, asks for.
const ScpiVoltmeterFirmware::Meter::KeptSetting* ScpiVoltmeterFirmware::Meter::kept_setting(
    std::string_view header) const {
  if (header.ends_with('?')) header.remove_suffix(1);
  const auto found =
      std::find_if(kept_settings().begin(), kept_settings().end(), [&](const KeptSetting& each) {
        return (each.families & family()) != 0 && matches(each.pattern, header);
      });
  return found == kept_settings().end() ? nullptr : &*found;
}

std::string ScpiVoltmeterFirmware::Meter::kept(const KeptSetting& setting) const {
  const auto found = kept_.find(setting.pattern);
  const std::string value = found != kept_.end() ? found->second : std::string(setting.initial);
  switch (setting.kind) {
    case Kind::kNumber:
      return fmt::format("{:+.8E}", number(value));
    case Kind::kText:
      return '"' + value + '"';
    default:
      return value;
  }
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::keep(const KeptSetting& setting,
                                                                       const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  std::string value = a[0];
  switch (setting.kind) {
    case Kind::kBoolean:
      value = boolean(value) ? "1" : "0";
      break;
    case Kind::kNumber:
      number(value);
      break;
    case Kind::kWhole:
      value = fmt::format("{}", std::lround(number(value)));
      break;
    case Kind::kWord:
      value = upper(value);
      break;
    case Kind::kText:
      std::erase_if(value, [](char c) { return c == '"' || c == '\''; });
  }
  kept_[setting.pattern] = value;
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::clear_text(const Arguments&) {
  kept_.erase("DISPlay:TEXT[:DATA]");
  return std::nullopt;
}

// Bytes.

void ScpiVoltmeterFirmware::Meter::receive(std::string_view bytes, Clock::Instant now) {
  run_waiting(now);
  now_ = now;
  for (const char c : bytes) {
    if (c == '\x03') {  // Ctrl-C on a serial line: device clear.
      input_.clear();
      waiting_.clear();
      busy_until_.reset();
      replies_.clear();
      measured_until_ = std::min(measured_until_, now_);
    } else if (c == '\n' || c == '\r') {
      std::string message = std::exchange(input_, {});
      if (pieces::trimmed(message).empty()) continue;
      if (busy_until_) {
        waiting_.push_back(std::move(message));
      } else {
        run_message(message);
      }
    } else if (input_.size() < kLongestMessage) {
      input_.push_back(c);
    } else {
      input_.clear();
      remember(kTooMuchData);
    }
  }
}

void ScpiVoltmeterFirmware::Meter::run_waiting(Clock::Instant now) {
  while (busy_until_ && *busy_until_ <= now) {
    now_ = std::max(now_, *busy_until_);
    busy_until_.reset();
    while (!busy_until_ && !waiting_.empty()) {
      const std::string message = std::move(waiting_.front());
      waiting_.pop_front();
      run_message(message);
    }
  }
}

std::string ScpiVoltmeterFirmware::Meter::transmit(Clock::Instant now) {
  run_waiting(now);
  return replies_.take(now);
}

std::optional<Clock::Instant> ScpiVoltmeterFirmware::Meter::next_due() const {
  const auto due = replies_.next_due();
  if (!busy_until_ || *busy_until_ == Clock::Instant::max() || waiting_.empty()) return due;
  return due ? std::min(*due, *busy_until_) : *busy_until_;
}

void ScpiVoltmeterFirmware::Meter::run_message(const std::string& message) {
  settle();
  std::string answer;
  std::string path;
  for (const std::string& unit : split(message, ';')) {
    if (unit.empty()) continue;
    const std::size_t space = unit.find_first_of(" \t");
    const std::string header = upper(std::string_view(unit).substr(0, space));
    const std::string_view rest =
        space == std::string::npos ? "" : pieces::trimmed(std::string_view(unit).substr(space));
    try {
      if (const Reply reply = run_command(header, rest, path)) {
        if (!answer.empty()) answer += ';';
        answer += *reply;
      }
    } catch (const Refusal& refusal) {
      remember(refusal.code);  // A refused query does not answer.
      if (refusal.code == kUndefinedHeader) unserved_.note(header, "not emulated: error -113", unit);
    }
  }
  if (!answer.empty()) replies_.push(answer + "\n", busy_until_.value_or(now_) + settings_.reply_delay);
}

/// `path`: the node of the command before it in the message ("SENS:VOLT:DC:"), which a command without
/// leading colon continues.
ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::run_command(std::string header,
                                                                              std::string_view arguments,
                                                                              std::string& path) {
  const bool from_root = header.starts_with(':');
  if (from_root) header.erase(0, 1);
  std::vector<std::string> tries{header};
  if (!from_root && !path.empty() && !header.starts_with('*')) tries.push_back(path + header);
  for (const std::string& each : tries) {
    const auto found = std::find_if(commands().begin(), commands().end(), [&](const Command& command) {
      return (command.families & family()) != 0 && matches(command.pattern, each);
    });
    if (found == commands().end()) continue;
    if (!each.starts_with('*')) {
      const std::size_t colon = each.rfind(':');
      path = colon == std::string::npos ? "" : each.substr(0, colon + 1);
    }
    return (this->*found->run)(arguments.empty() ? Arguments{} : split(arguments, ','));
  }
  for (const std::string& each : tries) {
    const KeptSetting* setting = kept_setting(each);
    if (setting == nullptr) continue;
    const std::size_t colon = each.rfind(':');
    path = colon == std::string::npos ? "" : each.substr(0, colon + 1);
    if (each.ends_with('?')) return kept(*setting);
    return keep(*setting, arguments.empty() ? Arguments{} : split(arguments, ','));
  }
  throw Refusal{kUndefinedHeader};
}

/// Sets the registers once a measurement has ended.
void ScpiVoltmeterFirmware::Meter::settle() {
  if (now_ < measured_until_) return;
  if (std::exchange(measuring_, false)) {
    status_.latch(ScpiStatus::kOperation, keithley() ? kKeithleyIdle : 0U);
    status_.latch(ScpiStatus::kMeasurement, kReadingAvailable | kBufferFull);
    for (const Sample& sample : samples_) {
      if (std::abs(sample.value) < kOverload) continue;
      status_.latch(ScpiStatus::kQuestionable, kVoltageOverload);
      status_.latch(ScpiStatus::kMeasurement, 1U);
      if (settings_.model == "34401A") status_.happen(ScpiStatus::kDeviceError);
    }
  }
  if (std::exchange(tells_completion_, false)) status_.happen(ScpiStatus::kOperationComplete);
}

unsigned ScpiVoltmeterFirmware::Meter::operation_condition() const {
  if (now_ < measured_until_) return kMeasuring;
  return keithley() ? kKeithleyIdle : 0U;
}

void ScpiVoltmeterFirmware::Meter::remember(int code) {
  status_.error(code);
  if (errors_.size() + 1 < kErrorMemory) {
    errors_.push_back(code);
  } else if (errors_.size() < kErrorMemory) {
    errors_.push_back(kQueueOverflow);
  }
}

// Settings.

bool ScpiVoltmeterFirmware::Meter::is_channel(int channel) const {
  if (std::find(settings_.channels.begin(), settings_.channels.end(), channel) != settings_.channels.end())
    return true;
  return channel > 100 && channel <= 100 + kChannelsOfACard;  // Card in slot 1; its other inputs are open.
}

/// "(@101,102:104)". Empty list: "(@)".
std::vector<int> ScpiVoltmeterFirmware::Meter::channel_list(std::string_view text) const {
  if (!text.starts_with("(@") || !text.ends_with(')')) throw Refusal{kIllegalParameter};
  std::vector<int> channels;
  const std::string_view inside = pieces::trimmed(text.substr(2, text.size() - 3));
  if (inside.empty()) return channels;
  for (const std::string& part : split(inside, ',')) {
    const std::vector<std::string> ends = split(part, ':');
    if (ends.size() > 2) throw Refusal{kIllegalParameter};
    const double first = number(ends.front());
    const double last = number(ends.back());
    if (first != std::floor(first) || last != std::floor(last) || first > last || first < 1 || last > 9999)
      throw Refusal{kDataOutOfRange};
    for (int channel = static_cast<int>(first); channel <= static_cast<int>(last); ++channel) {
      if (!is_channel(channel)) throw Refusal{kDataOutOfRange};
      channels.push_back(channel);
    }
  }
  return channels;
}

/// Takes the channel list off the end of the arguments.
std::optional<std::vector<int>> ScpiVoltmeterFirmware::Meter::take_channel_list(Arguments& a) const {
  if (a.empty() || !a.back().starts_with("(@")) return std::nullopt;
  if (single()) throw Refusal{kParameterNotAllowed};
  auto channels = channel_list(a.back());
  a.pop_back();
  return channels;
}

double ScpiVoltmeterFirmware::Meter::number_or_limit(std::string_view text, double lowest,
                                                     double highest) const {
  const std::string word = upper(text);
  if (word == "MIN" || word == "MINIMUM") return lowest;
  if (word == "MAX" || word == "MAXIMUM") return highest;
  const double value = number(text);
  if (!(value >= lowest && value <= highest)) throw Refusal{kDataOutOfRange};
  return value;
}

void ScpiVoltmeterFirmware::Meter::set_range(std::string_view text) {
  const std::string word = upper(text);
  if (word == "AUTO" || word == "DEF" || word == "DEFAULT") {
    range_ = 0.0;
    return;
  }
  const double wanted = std::abs(number_or_limit(text, 0.0, kRanges.back()));
  range_ = *std::find_if(kRanges.begin(), kRanges.end(), [&](double range) { return wanted <= range; });
}

/// A resolution chooses the integration time: 4 1/2 digits need 0.02 power line cycles, 6 1/2 need 10
/// [unverified against a device].
void ScpiVoltmeterFirmware::Meter::set_resolution(std::string_view text) {
  const std::string word = upper(text);
  const double range = range_ > 0.0 ? range_ : kRanges.back();
  if (word == "DEF" || word == "DEFAULT") {
    nplc_ = 1.0;
  } else if (word == "AUTO") {
    if (!settings_.accepts_second_auto) throw Refusal{kIllegalParameter};
    nplc_ = 1.0;
  } else if (word == "MAX" || word == "MAXIMUM") {
    nplc_ = kKeysightNplc.front();
  } else if (word == "MIN" || word == "MINIMUM") {
    nplc_ = kKeysightNplc.back();
  } else {
    const double parts = number(text) / range;
    if (!(parts > 0.0) || parts > 1e-3) throw Refusal{kDataOutOfRange};
    nplc_ = parts >= 1e-4 ? 0.02 : parts >= 1e-5 ? 0.2 : parts >= 3e-6 ? 1.0 : parts >= 1e-6 ? 10.0 : 100.0;
  }
}

void ScpiVoltmeterFirmware::Meter::set_nplc(std::string_view text) {
  if (keithley()) {
    nplc_ = number_or_limit(text, 0.01, settings_.line_frequency_hz);
    return;
  }
  const double wanted = number_or_limit(text, kKeysightNplc.front(), kKeysightNplc.back());
  nplc_ =
      *std::find_if(kKeysightNplc.begin(), kKeysightNplc.end(), [&](double each) { return wanted <= each; });
}

// Measurement.

Clock::Duration ScpiVoltmeterFirmware::Meter::channel_time() const {
  const double integrations = auto_zero_ ? 2.0 : 1.0;
  return from_seconds(integrations * nplc_ / settings_.line_frequency_hz + channel_delay_s_) +
         settings_.channel_overhead;
}

/// The channels of one measurement, in order; 0 is the input of a meter with one.
std::vector<int> ScpiVoltmeterFirmware::Meter::scanned() const {
  std::vector<int> channels;
  if (single()) {
    channels.assign(sample_count_ * trigger_count_, 0);
  } else if (keithley()) {
    // Readings are counted; a list shorter than the count begins again.
    const int alone = closed_channel_ != 0 ? closed_channel_ : settings_.channels[0];
    const std::vector<int> list = scans_ && !scan_list_.empty() ? scan_list_ : std::vector<int>{alone};
    for (std::size_t n = 0; n < sample_count_ * trigger_count_ * arm_count_; ++n)
      channels.push_back(list[n % list.size()]);
  } else {
    if (scan_list_.empty()) throw Refusal{kInitIgnored};
    for (std::size_t n = 0; n < trigger_count_; ++n)
      channels.insert(channels.end(), scan_list_.begin(), scan_list_.end());
  }
  if (channels.size() > kMostReadings) throw Refusal{kTooMuchData};
  return channels;
}

void ScpiVoltmeterFirmware::Meter::check_remote() const {
  if (settings_.needs_remote && !remote_) throw Refusal{kLocalLockout};
}

void ScpiVoltmeterFirmware::Meter::begin_measurement() {
  check_remote();
  if (continuous_ || now_ < measured_until_) throw Refusal{kInitIgnored};
  const std::vector<int> channels = scanned();
  measuring_ = true;
  status_.latch(ScpiStatus::kOperation, kMeasuring);
  samples_.clear();
  const std::size_t in_a_scan = keithley() || single()
                                    ? std::max<std::size_t>(1, std::min(channels.size(), scan_list_.size()))
                                    : scan_list_.size();
  const Clock::Duration each = channel_time();
  const Clock::Duration period = each * static_cast<std::int64_t>(in_a_scan);
  Clock::Instant t = now_;
  for (std::size_t n = 0; n < channels.size(); ++n) {
    t += each;
    if (const auto fault = bench_->fault_at(FaultKind::kNoOutput, t)) {
      t = fault->until;
      if (t == Clock::Instant::max()) {
        measured_until_ = t;
        has_samples_ = false;
        return;
      }
    }
    samples_.push_back({measure(channels[n], t, scans_made_ + n / in_a_scan, period), channels[n], t});
  }
  scans_made_ += (channels.size() + in_a_scan - 1) / in_a_scan;
  measured_until_ = t;
  has_samples_ = true;
}

double ScpiVoltmeterFirmware::Meter::measure(int channel, Clock::Instant t, std::uint64_t index,
                                             Clock::Duration period) const {
  std::size_t which = settings_.single_channel;
  if (channel != 0) {
    const auto found = std::find(settings_.channels.begin(), settings_.channels.end(), channel);
    if (found == settings_.channels.end()) return 0.0;  // Nothing is connected there.
    which = static_cast<std::size_t>(found - settings_.channels.begin());
  }
  const SimOutput output = bench_->output(t, index, period);
  const double value = output.value(static_cast<Eigen::Index>(which));
  const double largest = range_ == 0.0 || range_ == kRanges.back() ? kRanges.back() : kOverRange * range_;
  if (!(std::abs(value) <= largest) || output.clipped[which])
    return std::signbit(value) ? -kOverload : kOverload;
  return value;
}

std::string ScpiVoltmeterFirmware::Meter::text_of_sample(const Sample& sample, std::size_t index) const {
  if (is_2001()) {
    std::string text = fmt::format("{:+.7E}", sample.value);
    if (with_unit_) text += "VDC";
    if (with_time_) text += fmt::format(",{:+.6f}SECS", to_seconds(sample.time - samples_.front().time));
    if (with_number_) text += fmt::format(",+{:05}RDNG#", index);
    if (with_channel_) text += fmt::format(",{:02}{}", scans_ ? sample.channel : 0, "INTCHAN");
    return text;
  }
  std::string text = fmt::format("{:+.8E}", sample.value);
  if (keithley()) {
    if (with_unit_) text += "VDC";
    if (with_time_) text += fmt::format(",{:+.3f}SECS", to_seconds(sample.time - samples_.front().time));
    if (with_number_) text += fmt::format(",+{:05}RDNG#", index);
    if (with_channel_) text += fmt::format(",{:03}", scans_ ? sample.channel : 0);
    return text;
  }
  if (with_unit_) text += " VDC";
  if (with_time_) text += fmt::format(",{:012.3f}", to_seconds(sample.time - samples_.front().time));
  if (with_channel_) text += fmt::format(",{}", sample.channel);
  return text;
}

std::string ScpiVoltmeterFirmware::Meter::readings() const {
  std::string text;
  for (std::size_t n = 0; n < samples_.size(); ++n) {
    if (n > 0) text += ',';
    text += text_of_sample(samples_[n], n);
  }
  return text;
}

// Commands.

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::idn(const Arguments&) {
  return settings_.identity;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::rst(const Arguments&) {
  measured_until_ = std::min(measured_until_, now_);
  power_on();
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::cls(const Arguments&) {
  errors_.clear();
  status_.clear();
  tells_completion_ = false;
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::clear_errors(const Arguments&) {
  errors_.clear();
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::preset(const Arguments&) {
  status_.preset();
  return std::nullopt;
}

/// Does not wait: the bit reports the end of the measurement.
ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::opc(const Arguments&) {
  tells_completion_ = true;
  settle();
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::wait(const Arguments&) {
  if (measured_until_ > now_) busy_until_ = measured_until_;
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_opc(const Arguments& a) {
  wait(a);
  return "1";
}

/// A whole number. @throws Refusal
unsigned ScpiVoltmeterFirmware::Meter::register_value(const Arguments& a, unsigned largest) {
  if (a.empty()) throw Refusal{kMissingParameter};
  const double value = number(a[0]);
  if (!(value >= 0.0 && value <= largest)) throw Refusal{kDataOutOfRange};
  return static_cast<unsigned>(value);
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::event_enable(const Arguments& a) {
  status_.standard_enable = register_value(a, 255);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::service_enable(const Arguments& a) {
  status_.service_enable = register_value(a, 255);
  return std::nullopt;
}

/// How often the relays of these channels have switched.
ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::relay_counts(const Arguments& a) {
  Arguments rest = a;
  const auto channels = take_channel_list(rest);
  if (!channels) throw Refusal{kMissingParameter};
  std::string text;
  for (std::size_t n = 0; n < channels->size(); ++n) text += n == 0 ? "+0" : ",+0";
  return text;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::close_channel(const Arguments& a) {
  Arguments rest = a;
  const auto channels = take_channel_list(rest);
  if (!channels || channels->empty()) throw Refusal{kMissingParameter};
  closed_channel_ = channels->front();
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::open_channels(const Arguments&) {
  closed_channel_ = 0;
  return std::nullopt;
}

/// Channels that are closed: "(@101)".
ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_closed(const Arguments&) {
  return closed_channel_ == 0 ? "(@)" : fmt::format("(@{})", closed_channel_);
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_closed_states(const Arguments& a) {
  Arguments rest = a;
  const auto channels = take_channel_list(rest);
  if (!channels || channels->empty()) throw Refusal{kMissingParameter};
  std::string states;
  for (const int channel : *channels)
    states += fmt::format("{}{}", states.empty() ? "" : ",", channel == closed_channel_ ? 1 : 0);
  return states;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::arm_count(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  arm_count_ = static_cast<std::size_t>(number_or_limit(a[0], 1.0, static_cast<double>(kMostReadings)));
  return std::nullopt;
}

/// The readings of the measurement that was made last.
ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::stored(const Arguments& a) {
  return fetch(a);
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_error(const Arguments&) {
  int code = 0;
  if (!errors_.empty()) {
    code = errors_.front();
    errors_.pop_front();
  }
  if (keithley() && code == 0) return "0, \"no error\"";
  const std::string_view text = kErrorTexts.of(code, "Error");
  return keithley() ? fmt::format("{},\"{}\"", code, text) : fmt::format("{:+},\"{}\"", code, text);
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::remote(const Arguments&) {
  remote_ = true;
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::local(const Arguments&) {
  remote_ = false;
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::configure(const Arguments& a) {
  check_remote();
  if (now_ < measured_until_) throw Refusal{kInitIgnored};
  Arguments rest = a;
  const auto channels = take_channel_list(rest);
  if (rest.size() > 2) throw Refusal{kParameterNotAllowed};
  if (settings_.family == ScpiFamily::kKeysight34970a && !channels) throw Refusal{kMissingParameter};
  const double range_before = range_;
  const double nplc_before = nplc_;
  try {
    range_ = 0.0;
    nplc_ = 1.0;
    if (!rest.empty()) set_range(rest[0]);
    if (rest.size() > 1) set_resolution(rest[1]);
  } catch (const Refusal&) {
    range_ = range_before;  // All or nothing.
    nplc_ = nplc_before;
    throw;
  }
  trigger_source_ = "IMM";
  trigger_count_ = sample_count_ = 1;
  has_samples_ = false;
  if (channels) scan_list_ = *channels;
  return std::nullopt;
}

/// In volts.
double ScpiVoltmeterFirmware::Meter::resolution_of_range() const {
  const double digits = nplc_ >= 10.0 ? 1e-6 : nplc_ >= 1.0 ? 3e-6 : nplc_ >= 0.2 ? 1e-5 : 1e-4;
  return digits * (range_ > 0.0 ? range_ : 10.0);
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_configure(const Arguments& a) {
  if (keithley()) return "\"VOLT:DC\"";
  const double range = range_ > 0.0 ? range_ : 10.0;
  const std::string one = fmt::format("\"VOLT {:+.6E},{:+.6E}\"", range, resolution_of_range());
  Arguments rest = a;
  const auto channels = take_channel_list(rest);
  std::size_t count = 1;
  if (settings_.family == ScpiFamily::kKeysight34970a)
    count = channels ? channels->size() : scan_list_.size();
  std::string text;
  for (std::size_t n = 0; n < count; ++n) {
    if (n > 0) text += ',';
    text += one;
  }
  return text;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::measure_once(const Arguments& a) {
  configure(a);
  if (keithley()) scans_ = !scan_list_.empty();
  return read({});
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::function(const Arguments& a) {
  Arguments rest = a;
  take_channel_list(rest);
  if (rest.empty()) throw Refusal{kMissingParameter};
  std::string name = upper(rest[0]);
  std::erase_if(name, [](char c) { return c == '"' || c == '\''; });
  // A voltmeter measures other things as well; this one only direct voltage.
  if (name != "VOLT" && name != "VOLT:DC" && name != "VOLTAGE" && name != "VOLTAGE:DC") {
    unserved_.note("FUNC " + name, "not emulated: error -224");
    throw Refusal{kIllegalParameter};
  }
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::nplc(const Arguments& a) {
  Arguments rest = a;
  take_channel_list(rest);
  if (rest.empty()) throw Refusal{kMissingParameter};
  set_nplc(rest[0]);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_nplc(const Arguments& a) {
  Arguments rest = a;
  const auto channels = take_channel_list(rest);
  std::string text;
  for (std::size_t n = 0; n < (channels ? channels->size() : 1); ++n)
    text += fmt::format("{}{:+.8E}", n == 0 ? "" : ",", nplc_);
  return text;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::range(const Arguments& a) {
  Arguments rest = a;
  take_channel_list(rest);
  if (rest.empty()) throw Refusal{kMissingParameter};
  set_range(rest[0]);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_range(const Arguments&) {
  return fmt::format("{:+.8E}", range_ > 0.0 ? range_ : 10.0);
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::range_auto(const Arguments& a) {
  Arguments rest = a;
  take_channel_list(rest);
  if (rest.empty()) throw Refusal{kMissingParameter};
  range_ = boolean(rest[0]) ? 0.0 : (range_ > 0.0 ? range_ : 10.0);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_range_auto(const Arguments&) {
  return range_ == 0.0 ? "1" : "0";
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::resolution(const Arguments& a) {
  Arguments rest = a;
  take_channel_list(rest);
  if (rest.empty()) throw Refusal{kMissingParameter};
  set_resolution(rest[0]);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::zero_auto(const Arguments& a) {
  Arguments rest = a;
  take_channel_list(rest);
  if (rest.empty()) throw Refusal{kMissingParameter};
  auto_zero_ = boolean(rest[0]);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_zero_auto(const Arguments&) {
  return auto_zero_ ? "1" : "0";
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::scan(const Arguments& a) {
  check_remote();
  if (a.empty()) throw Refusal{kMissingParameter};
  if (a.size() > 1) throw Refusal{kParameterNotAllowed};
  scan_list_ = channel_list(a[0]);
  has_samples_ = false;
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::ask_scan(const Arguments&) {
  std::string list = "(@";
  for (std::size_t n = 0; n < scan_list_.size(); ++n)
    list += fmt::format("{}{}", n == 0 ? "" : ",", scan_list_[n]);
  list += ")";
  if (keithley()) return list;
  const std::string size = std::to_string(list.size());
  return fmt::format("#{}{}{}", size.size(), size, list);
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::scan_select(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  const std::string word = upper(a[0]);
  if (word == "NONE") {
    scans_ = false;
  } else if (word == "INT" || word == "INTERNAL") {
    if (scan_list_.empty()) throw Refusal{kInitIgnored};
    scans_ = true;
  } else {
    throw Refusal{kIllegalParameter};
  }
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::trigger_source(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  const std::string word = upper(a[0]);
  // No external trigger is simulated.
  if (word != "IMM" && word != "IMMEDIATE") throw Refusal{kIllegalParameter};
  trigger_source_ = "IMM";
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::trigger_count(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  trigger_count_ = static_cast<std::size_t>(number_or_limit(a[0], 1.0, static_cast<double>(kMostReadings)));
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::sample_count(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  sample_count_ = static_cast<std::size_t>(number_or_limit(a[0], 1.0, static_cast<double>(kMostReadings)));
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::delay(const Arguments& a) {
  Arguments rest = a;
  take_channel_list(rest);
  if (rest.empty()) throw Refusal{kMissingParameter};
  channel_delay_s_ = number_or_limit(rest[0], 0.0, 60.0);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::with_channel(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  with_channel_ = boolean(a[0]);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::with_unit(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  with_unit_ = boolean(a[0]);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::with_time(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  with_time_ = boolean(a[0]);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::elements(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  bool channel = false;
  bool unit = false;
  bool time = false;
  bool count = false;
  for (const std::string& each : a) {
    const std::string word = upper(each);
    const auto is = [&](std::string_view pattern) { return matches(pattern, word); };
    if (is("CHANnel")) {
      channel = true;
    } else if (is("UNITs") || word == "UNIT") {
      unit = true;
    } else if (is("TSTamp")) {
      time = true;
    } else if (is("RNUMber")) {
      count = true;
    } else if (!is("READing") && !is("LIMits")) {
      throw Refusal{kIllegalParameter};
    }
  }
  with_channel_ = channel;
  with_unit_ = unit;
  with_time_ = time;
  with_number_ = count;
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::initiate(const Arguments&) {
  begin_measurement();
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::initiate_continuous(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  continuous_ = boolean(a[0]);
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::fetch(const Arguments&) {
  if (measured_until_ > now_) busy_until_ = measured_until_;
  if (!has_samples_) throw Refusal{kDataStale};
  return readings();
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::read(const Arguments&) {
  begin_measurement();
  return fetch({});
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::abort(const Arguments&) {
  measured_until_ = std::min(measured_until_, now_);
  std::erase_if(samples_, [&](const Sample& sample) { return sample.time > now_; });
  has_samples_ = !samples_.empty();
  return std::nullopt;
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::card(const Arguments& a) {
  if (a.empty()) throw Refusal{kMissingParameter};
  const double slot = number(a[0]);
  if (slot != 100.0 && slot != 200.0 && slot != 300.0) throw Refusal{kDataOutOfRange};
  return slot == 100.0 ? "HEWLETT-PACKARD,34901A,0,2.3" : "HEWLETT-PACKARD,0,0,0";
}

ScpiVoltmeterFirmware::Meter::Reply ScpiVoltmeterFirmware::Meter::points(const Arguments&) {
  const auto made =
      std::count_if(samples_.begin(), samples_.end(), [&](const Sample& s) { return s.time <= now_; });
  return fmt::format("{:+}", made);
}

ScpiVoltmeterFirmware::ScpiVoltmeterFirmware(std::shared_ptr<SimBench> bench,
                                             ScpiVoltmeterSettings settings) {
  encase(std::make_unique<Meter>(std::move(bench), std::move(settings), unserved()));
}

ScpiVoltmeterSettings scpi_model(const std::string& model) {
  const Model& found = model_named(model);
  ScpiVoltmeterSettings settings;
  settings.family = found.family;
  settings.model = model;
  if (model == "2000" || model == "2001") settings.channels = {1, 2, 3};
  return settings;
}

}  // namespace abcal::sim
