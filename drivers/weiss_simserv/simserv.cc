#include <fmt/format.h>

#include <cmath>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/weiss_simserv/codec.h"
#include "drivers/weiss_simserv/dialect.h"

namespace abcal::weiss_simserv {
namespace {

// Command numbers (docs/protocols/weiss_simserv.md).
constexpr int kIdentity = 99997, kUnit = 11023, kName = 11026, kVariables = 11018, kActual = 11004,
              kNominal = 11002, kSet = 11001, kLeast = 11007, kMost = 11009, kSetGradientUp = 11068,
              kSetGradientDown = 11072, kSwitch = 14001, kIsOn = 14003, kMessages = 17002,
              kMessageActive = 17009, kMessageType = 17005, kMessageText = 17007;
constexpr double kSame = 0.06;
constexpr int kMostMessages = 64;

bool has_word(std::string text, std::string_view word) {
  for (char& c : text)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return text.find(word) != std::string::npos;
}

class Simserv final : public Dialect {
 public:
  Simserv(wire::QueryExchange& exchange, const ChamberSettings& settings)
      : exchange_(exchange), settings_(settings) {}

  ChamberInfo identify() override;
  void set_temperature(double degc, std::optional<double> rate_k_per_min) override;
  void switch_run(bool on) override { set_output(1, on); }
  void switch_output(int number, bool on) override { set_output(number + 1, on); }
  ChamberReading read() override;
  std::optional<HaltRecipe> rest_recipe(ChamberPolicy policy) override;

 private:
  InstrumentError failure(Fault fault, std::string_view detail) const {
    return {exchange_.manner().who, fault, detail};
  }
  SimservReply ask(int number, const std::vector<std::string>& arguments, std::size_t values) {
    return exchange_.ask(simserv_request(number, arguments), fmt::format("{}", number),
                         [&](const std::string& frame) -> std::optional<SimservReply> {
                           auto reply = parse_simserv(line_text(frame));
                           if (!reply || (reply->code == 1 && reply->values.size() != values))
                             return std::nullopt;
                           return reply;
                         });
  }
  /// Asks for one value. @throws kRefused
  std::string value(int number, const std::vector<std::string>& arguments) {
    SimservReply reply = ask(number, arguments, 1);
    require(reply, number);
    return reply.values.at(0);
  }
  double number(int command, const std::vector<std::string>& arguments) {
    const std::string text = value(command, arguments);
    if (const auto found = parse_number(text)) return *found;
    throw failure(Fault::kBadFrame, fmt::format("\"{}\" in answer to {}; required: a number", text, command));
  }
  void tell(int command, const std::vector<std::string>& arguments) {
    require(ask(command, arguments, 0), command);
  }
  void require(const SimservReply& reply, int command) const {
    if (reply.code == 1) return;
    throw failure(Fault::kRefused,
                  fmt::format("code {} ({}) to command {}", reply.code, refusal_text(reply.code), command));
  }
  void set_output(int index, bool on) {
    const std::string which = std::to_string(index);
    tell(kSwitch, {which, on ? "1" : "0"});
    if ((number(kIsOn, {which}) != 0.0) != on)
      throw failure(
          Fault::kRefused,
          fmt::format("it is {} after it was switched {}: is the external mode enabled at its panel?",
                      on ? "off" : "on", on ? "on" : "off"));
  }
  void verify_unit() {
    const std::string unit = value(kUnit, {"1"});
    if (unit.ends_with("C")) return;
    throw failure(
        Fault::kWrongIdentity,
        fmt::format("the unit of its temperature is \"{}\"; required: degC. Set it at its panel", unit));
  }
  void read_messages(ChamberReading& reading);

  wire::QueryExchange& exchange_;
  const ChamberSettings settings_;
  ChamberInfo info_;
};

ChamberInfo Simserv::identify() {
  info_ = {};
  info_.maker = "Weiss";
  try {
    info_.model = value(kIdentity, {"1"});
    info_.serial_number = value(kIdentity, {"3"});
    verify_unit();
    info_.least_set_degc = number(kLeast, {"1"});
    info_.most_set_degc = number(kMost, {"1"});
    if (!(info_.least_set_degc < info_.most_set_degc))
      throw failure(Fault::kWrongIdentity,
                    fmt::format("its limits of the set point read {:g} to {:g} degC; required: a range",
                                info_.least_set_degc, info_.most_set_degc));
    if (number(kVariables, {}) >= 2.0) info_.has_humidity = has_word(value(kName, {"2"}), "humid");
  } catch (const InstrumentError& error) {
    if (error.fault() != Fault::kRefused) throw;
    throw failure(Fault::kWrongIdentity, error.detail().english());
  }
  info_.can_ramp = true;
  info_.can_pause = settings_.pause_output > 0;
  return info_;
}

void Simserv::set_temperature(double degc, std::optional<double> rate_k_per_min) {
  verify_unit();
  const std::string rate = fmt::format("{}", rate_k_per_min.value_or(0.0));
  tell(kSetGradientUp, {"1", rate});
  tell(kSetGradientDown, {"1", rate});
  tell(kSet, {"1", fmt::format("{:.1f}", degc)});
  if (const double found = number(kNominal, {"1"}); !rate_k_per_min && !(std::abs(found - degc) < kSame))
    throw failure(Fault::kRefused,
                  fmt::format("its set point reads {:g} degC after {:g} degC was written", found, degc));
}

void Simserv::read_messages(ChamberReading& reading) {
  const int count = static_cast<int>(number(kMessages, {}));
  for (int n = 1; n <= count && n <= kMostMessages; ++n) {
    const std::string which = std::to_string(n);
    if (number(kMessageActive, {which}) == 0.0) continue;
    const std::string text = value(kMessageText, {which});
    if (has_word(text, "door")) reading.door_open = true;
    if (number(kMessageType, {which}) == 1.0) reading.alarms.push_back(text);
  }
}

ChamberReading Simserv::read() {
  ChamberReading reading;
  reading.air_degc = number(kActual, {"1"});
  reading.set_degc = number(kNominal, {"1"});
  if (info_.has_humidity) reading.humidity_percent = number(kActual, {"2"});
  reading.running = number(kIsOn, {"1"}) != 0.0;
  read_messages(reading);
  return reading;
}

std::optional<HaltRecipe> Simserv::rest_recipe(ChamberPolicy policy) {
  HaltRecipe recipe = rest_recipe_of_lines(exchange_.manner().patience, policy);
  const ReplyPart done = pattern::literal("1"), separator = pattern::any_bytes(1);
  const auto step = [&](int command, const std::vector<std::string>& arguments) {
    recipe.questions.push_back({simserv_request(command, arguments), {done}, {}});
  };
  if (settings_.pause_output > 0) step(kSwitch, {std::to_string(settings_.pause_output + 1), "0"});
  if (policy != ChamberPolicy::kHold) {
    step(kSetGradientUp, {"1", "0"});
    step(kSetGradientDown, {"1", "0"});
    step(kSet, {"1", fmt::format("{:.1f}", kAmbientDegc)});
    const ReplyPart zeros = pattern::run("0", 0);
    const std::string degc = fmt::format("{:g}", kAmbientDegc);
    recipe.questions.push_back(
        {simserv_request(kNominal, {"1"}),
         {done, separator, pattern::run("-+.0123456789")},
         ReplyPattern{done, separator, zeros, pattern::literal(degc)} |
             ReplyPattern{done, separator, zeros, pattern::literal(degc + "."), zeros}});
  } else if (settings_.pause_output > 0) {
    // An answer that no older one can be taken for.
    recipe.questions.push_back({simserv_request(kIdentity, {"1"}), {done, separator, pattern::text()}, {}});
  }
  return recipe.questions.empty() ? std::nullopt : std::optional(std::move(recipe));
}

}  // namespace

std::unique_ptr<Dialect> make_simserv(wire::QueryExchange& exchange, const ChamberSettings& settings) {
  return std::make_unique<Simserv>(exchange, settings);
}

}  // namespace abcal::weiss_simserv
