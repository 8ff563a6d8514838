#include "app/measure/emulator/compare_firmware.h"

#include <algorithm>
#include <cctype>
#include <regex>

#include "drivers/text/names.h"

namespace abcal {
namespace {

constexpr double kOneRequestS = 5e-3;
/// How long the last answer is waited for.
constexpr double kLastAnswerS = 1.0;

bool is_text(std::string_view bytes) {
  return std::ranges::all_of(bytes,
                             [](unsigned char c) { return std::isprint(c) != 0 || std::isspace(c) != 0; });
}

std::string without_numbers(const std::string& text) {
  static const std::regex kNumber(R"([-+]?[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?)");
  return std::regex_replace(text, kNumber, "#");
}

Likeness likeness_of(const std::string& real, const std::string& simulated) {
  if (real == simulated) return Likeness::kEqual;
  if (simulated.empty()) return Likeness::kOnlyReal;
  if (real.empty()) return Likeness::kOnlySimulated;
  const bool text = is_text(real) && is_text(simulated);
  if (text && without_numbers(real) == without_numbers(simulated)) return Likeness::kNumbersDiffer;
  if (!text && real.size() == simulated.size()) return Likeness::kSameLength;
  return Likeness::kDifferent;
}

/// The complete output up to `until`.
std::string output_until(sim::Firmware& firmware, Clock::Instant until) {
  std::string output;
  std::optional<Clock::Instant> last;
  for (auto due = firmware.next_due(); due && *due <= until && due != last; due = firmware.next_due()) {
    last = due;
    output += firmware.transmit(*due);
  }
  return output + firmware.transmit(until);
}

/// Pairs of the host's output and the real instrument's answer.
std::vector<ComparedExchange> exchanges_of(const WireLog& log) {
  std::vector<ComparedExchange> exchanges(1);
  double last_write_s = 0.0;
  for (const LoggedBytes& row : log.rows) {
    if (row.from == LoggedBytes::From::kInstrument) {
      exchanges.back().real += row.bytes;
      continue;
    }
    ComparedExchange& last = exchanges.back();
    const bool goes_on = !last.asked.empty() && last.real.empty() && row.t_s - last_write_s < kOneRequestS;
    if (goes_on) {
      last.asked += row.bytes;
    } else {
      exchanges.push_back({.t_s = row.t_s, .asked = row.bytes, .real = {}, .simulated = {}});
    }
    last_write_s = row.t_s;
  }
  return exchanges;
}

constexpr auto kLikenesses = names<Likeness>({{Likeness::kEqual, "equal"},
                                              {Likeness::kNumbersDiffer, "numbers differ"},
                                              {Likeness::kSameLength, "same length"},
                                              {Likeness::kDifferent, "different"},
                                              {Likeness::kOnlyReal, "only the real one answers"},
                                              {Likeness::kOnlySimulated, "only the simulated one answers"}});

}  // namespace

std::string_view to_string(Likeness likeness) {
  return kLikenesses.of(likeness);
}

std::vector<ComparedExchange> compare_firmware(const WireLog& log, sim::Firmware& firmware,
                                               Clock::Instant start) {
  std::vector<ComparedExchange> exchanges = exchanges_of(log);
  const auto at = [&](double t_s) { return start + from_seconds(t_s); };
  for (std::size_t i = 0; i < exchanges.size(); ++i) {
    ComparedExchange& each = exchanges[i];
    if (!each.asked.empty()) firmware.receive(each.asked, at(each.t_s));
    const double end_s = i + 1 < exchanges.size() ? exchanges[i + 1].t_s
                         : log.rows.empty()       ? 0.0
                                                  : log.rows.back().t_s + kLastAnswerS;
    each.simulated = output_until(firmware, at(end_s));
    each.likeness = likeness_of(each.real, each.simulated);
  }
  std::erase_if(exchanges, [](const ComparedExchange& each) {
    return each.asked.empty() && each.real.empty() && each.simulated.empty();
  });
  return exchanges;
}

}  // namespace abcal
