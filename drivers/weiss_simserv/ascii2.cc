#include <fmt/format.h>

#include <cmath>

#include "drivers/instrument/instrument_error.h"
#include "drivers/weiss_simserv/codec.h"
#include "drivers/weiss_simserv/dialect.h"

namespace abcal::weiss_simserv {
namespace {

constexpr double kSameAscii = 0.06;
/// The description has no visible end: nothing follows once the line has been silent for this time.
constexpr Clock::Duration kQuiet = std::chrono::milliseconds(400);
constexpr std::size_t kMostDescription = 65536;
constexpr Clock::Duration kLongestDescription = std::chrono::seconds(20);  // 19 kB at 9600 Bd.

class Ascii2 final : public Dialect {
 public:
  Ascii2(wire::QueryExchange& exchange, Clock& clock, const ChamberSettings& settings)
      : exchange_(exchange), clock_(clock), settings_(settings) {}

  ChamberInfo identify() override;
  void set_temperature(double degc, std::optional<double> rate_k_per_min) override;
  void switch_run(bool on) override;
  void switch_output(int number, bool on) override;
  ChamberReading read() override;
  std::optional<HaltRecipe> rest_recipe(ChamberPolicy policy) override;

 private:
  InstrumentError failure(Fault fault, std::string_view detail) const {
    return {exchange_.manner().who, fault, detail};
  }
  Ascii2State state() {
    return exchange_.ask(plain_command(settings_.address, 'I'), fmt::format("${:02}I", settings_.address),
                         [&](const std::string& frame) -> std::optional<Ascii2State> {
                           auto now = parse_state(line_text(frame));
                           if (!now || now->numbers.size() != layout_.state_order.size() ||
                               now->channels.size() != layout_.channels)
                             return std::nullopt;
                           return now;
                         });
  }
  void tell(const std::string& command) {
    const std::string shown(line_text(command));
    exchange_.ask(command, shown, [&](const std::string& frame) -> std::optional<bool> {
      return line_text(frame) == "0" ? std::optional(true) : std::nullopt;
    });
  }
  std::string describe();
  /// Sends all set points and channels unchanged, except the given ones.
  void set(const Ascii2State& now, double degc, const std::string& channels) {
    tell(set_command(settings_.address, layout_, now, degc, channels));
  }
  void set_channel(std::size_t channel, bool on);
  std::size_t start_channel() const { return layout_.start_channel.value_or(1); }

  wire::QueryExchange& exchange_;
  Clock& clock_;
  const ChamberSettings settings_;
  Ascii2Layout layout_;
  double target_degc_ = 0.0;  ///< While a slope runs, the nominal value is the one that moves.
};

std::string Ascii2::describe() {
  wire::ByteStream& stream = exchange_.stream();
  stream.discard_input();
  stream.write(plain_command(settings_.address, '?'));
  std::string text;
  Clock::Instant until = clock_.now() + exchange_.manner().patience;
  const Clock::Instant last = until + kLongestDescription;  // It may never end.
  while (text.size() < kMostDescription && clock_.now() < last) {
    const wire::ReceivedBytes received = stream.read_until(until);
    if (received.bytes.empty()) break;
    text += received.bytes;
    until = clock_.now() + kQuiet;
  }
  return text;
}

ChamberInfo Ascii2::identify() {
  std::string text = describe();
  if (text.empty()) text = describe();
  if (text.empty())
    throw failure(Fault::kNoReply, fmt::format("no answer to \"${:02}?\" either", settings_.address));
  const auto layout = parse_layout(text);
  if (!layout || !layout->least_set_degc || !layout->most_set_degc)
    throw failure(
        Fault::kWrongIdentity,
        fmt::format(
            "its answer to \"${:02}?\" does not describe CV01, the temperature, and its range: \"{}\"",
            settings_.address, wire::printable(text)));
  layout_ = *layout;
  target_degc_ = values_of(layout_, state(), "CV01").front();
  ChamberInfo info;
  info.maker = "Weiss";
  info.model = "ASCII-2 chamber";
  info.least_set_degc = *layout_.least_set_degc;
  info.most_set_degc = *layout_.most_set_degc;
  info.can_ramp = true;
  info.can_pause = settings_.pause_output > 0;
  info.has_humidity = layout_.humidity.has_value();
  return info;
}

void Ascii2::set_temperature(double degc, std::optional<double> rate_k_per_min) {
  const Ascii2State now = state();
  const double actual = values_of(layout_, now, "CV01").at(1);
  const double rate = rate_k_per_min.value_or(0.0);
  tell(slope_command(settings_.address, degc > actual ? rate : 0.0, degc > actual ? 0.0 : rate));
  set(now, degc, now.channels);
  target_degc_ = degc;
  const double found = values_of(layout_, state(), "CV01").front();
  if (!rate_k_per_min && !(std::abs(found - degc) < kSameAscii))
    throw failure(Fault::kRefused, fmt::format("its set point reads {:g} degC after {:g} degC was written: "
                                               "is the external mode enabled at its panel?",
                                               found, degc));
}

void Ascii2::set_channel(std::size_t channel, bool on) {
  const Ascii2State now = state();
  std::string channels = now.channels;
  if (channel >= channels.size())
    throw std::invalid_argument(fmt::format(
        "weiss_simserv: channel {}; required: one of the {} of this chamber", channel, channels.size()));
  channels[channel] = on ? '1' : '0';
  set(now, target_degc_, channels);
  if (state().channels[channel] != channels[channel])
    throw failure(
        Fault::kRefused,
        fmt::format("channel DO{:02} did not switch: is the external mode enabled at its panel?", channel));
}

void Ascii2::switch_run(bool on) {
  set_channel(start_channel(), on);
}

void Ascii2::switch_output(int number, bool on) {
  set_channel(static_cast<std::size_t>(number), on);
}

ChamberReading Ascii2::read() {
  const Ascii2State now = state();
  const std::vector<double> air = values_of(layout_, now, "CV01");
  ChamberReading reading;
  reading.set_degc = air.at(0);
  reading.air_degc = air.at(1);
  if (layout_.humidity) {
    const std::vector<double> humidity = values_of(layout_, now, fmt::format("CV{:02}", *layout_.humidity));
    if (humidity.size() == 2) reading.humidity_percent = humidity[1];
  }
  reading.running = now.channels[start_channel()] == '1';
  if (settings_.door_input > 0 && static_cast<std::size_t>(settings_.door_input) < now.channels.size())
    reading.door_open = now.channels[static_cast<std::size_t>(settings_.door_input)] == '1';
  return reading;
}

/// One command sets everything, so it repeats the present values of all other settings; but the chamber must
/// run and not pause. The set point for kHold is not known yet: a paused chamber stays paused.
std::optional<HaltRecipe> Ascii2::rest_recipe(ChamberPolicy policy) {
  if (policy == ChamberPolicy::kHold) return std::nullopt;
  const Ascii2State now = state();
  std::string channels = now.channels;
  const auto pause = static_cast<std::size_t>(settings_.pause_output);
  if (pause > 0 && pause < channels.size()) channels[pause] = '0';
  if (start_channel() < channels.size()) channels[start_channel()] = '1';
  HaltRecipe recipe = rest_recipe_of_lines(exchange_.manner().patience, policy);
  const ReplyPart zeros = pattern::run("0", 0), space = pattern::literal(" ");
  recipe.questions = {
      {slope_command(settings_.address, 0.0, 0.0), {pattern::literal("0")}, {}},
      {set_command(settings_.address, layout_, now, kAmbientDegc, channels), {pattern::literal("0")}, {}},
      {plain_command(settings_.address, 'I'),
       {pattern::run("-+.0123456789"), space, pattern::text(), space, pattern::run("01"),
        pattern::run("Z", 0, 1)},
       {zeros, pattern::literal(fmt::format("{:g}.", kAmbientDegc)), zeros, space, pattern::text()}}};
  return recipe;
}

}  // namespace

std::unique_ptr<Dialect> make_ascii2(wire::QueryExchange& exchange, Clock& clock,
                                     const ChamberSettings& settings) {
  return std::make_unique<Ascii2>(exchange, clock, settings);
}

}  // namespace abcal::weiss_simserv
