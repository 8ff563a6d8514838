#include "drivers/weiss_simserv/chamber.h"

#include <fmt/format.h>

#include <stdexcept>
#include <utility>

#include "drivers/weiss_simserv/codec.h"

namespace abcal::weiss_simserv {
namespace {

constexpr Clock::Duration kPatience = std::chrono::seconds(1);

}  // namespace

WeissChamber::WeissChamber(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                           const ChamberSettings& settings)
    : settings_(settings),
      clock_(clock),
      exchange_(stream ? std::move(stream) : throw std::invalid_argument("WeissChamber: no stream"), clock,
                {.who = "chamber weiss_simserv", .patience = kPatience, .check = check_line}) {
  if (!settings.model.empty() && settings.model != "simserv" && settings.model != "ascii2")
    throw std::invalid_argument("weiss_simserv: model is \"" + settings.model +
                                "\"; required: \"simserv\", \"ascii2\", or nothing");
  exchange_.manner().who = fmt::format("chamber weiss_simserv on {}", exchange_.stream().name());
}

Dialect& WeissChamber::dialect() {
  if (info_ && dialect_) return *dialect_;
  throw InstrumentError(exchange_.manner().who, Fault::kNotReady, "asked before it was identified");
}

/// A question whose answer cannot be taken for another one: the type of the chamber, or the whole of its
/// state.
void WeissChamber::choose(bool simserv) {
  if (simserv) {
    exchange_.manner().sync_request = simserv_request(99997, {"1"});
    exchange_.manner().is_sync = [](const std::string& frame) {
      const auto reply = parse_simserv(line_text(frame));
      return reply && reply->values.size() == 1 && !parse_number(reply->values[0]);
    };
    dialect_ = make_simserv(exchange_, settings_);
  } else {
    exchange_.manner().sync_request = plain_command(settings_.address, 'I');
    exchange_.manner().is_sync = [](const std::string& frame) {
      return parse_state(line_text(frame)).has_value();
    };
    dialect_ = make_ascii2(exchange_, clock_, settings_);
  }
}

ChamberInfo WeissChamber::identify() {
  info_.reset();
  if (settings_.model != "ascii2") {
    try {
      choose(true);
      info_ = dialect_->identify();
      return *info_;
    } catch (const InstrumentError& error) {
      const bool another = error.fault() == Fault::kNoReply || error.fault() == Fault::kBadFrame;
      if (settings_.model == "simserv" || !another) throw;
    }
  }
  choose(false);
  info_ = dialect_->identify();
  return *info_;
}

void WeissChamber::set_temperature(double degc, std::optional<double> rate_k_per_min) {
  Dialect& used = dialect();
  if (!(degc >= info_->least_set_degc && degc <= info_->most_set_degc))
    throw InstrumentError(exchange_.manner().who, Fault::kOutOfTravel,
                          fmt::format("set point {:g} degC; required: {:g} to {:g} degC, the limits of its "
                                      "hardware",
                                      degc, info_->least_set_degc, info_->most_set_degc));
  used.set_temperature(degc, rate_k_per_min);
}

bool WeissChamber::pause(bool paused) {
  if (settings_.pause_output <= 0) return false;
  dialect().switch_output(settings_.pause_output, paused);
  return true;
}

}  // namespace abcal::weiss_simserv
