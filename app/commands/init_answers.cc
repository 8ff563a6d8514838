#include "app/commands/init_answers.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "app/document/valid_text.h"
#include "app/measure/session/small_turn.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "protocol/gravity/local_gravity.h"

namespace abcal {
namespace {

constexpr double kMostTravelDeg = 36000.0;  // as travel_min_deg of a bench file

double number(std::string_view word, std::string_view what) {
  if (word.find(',') != std::string_view::npos)
    throw std::invalid_argument(
        fmt::format("{}: found \"{}\"; required: a number with a decimal point", what, word));
  for (const char* dash : {"\u2212", "\u2013"})
    if (word.starts_with(dash))
      throw std::invalid_argument(
          fmt::format("{}: found \"{}\"; required: a number with - as its minus sign", what, word));
  const auto value = pieces::number<double>(word.starts_with('+') ? word.substr(1) : word);
  if (!value || !std::isfinite(*value))
    throw std::invalid_argument(
        fmt::format("{}: found \"{}\"; required: a number without a unit", what, word));
  return *value;
}

double number_within(std::string_view word, std::string_view what, double least, double most) {
  const double value = number(word, what);
  if (!(value >= least && value <= most))
    throw std::invalid_argument(
        fmt::format("{}: found {:g}; required: {:g} to {:g}", what, value, least, most));
  return value;
}

AxisTravel axis_travel(std::string_view text, std::string_view axis) {
  const auto words = pieces::words(text);
  if (words.size() != 2)
    throw std::invalid_argument(
        fmt::format("travel of {}: found \"{}\"; required: two numbers in degrees, the lower and the upper "
                    "end, as \"-100 365\"",
                    axis, pieces::trimmed(text)));
  const std::string what = fmt::format("travel of {} (degree)", axis);
  const double least = number_within(words[0], what, -kMostTravelDeg, kMostTravelDeg);
  const double most = number_within(words[1], what, -kMostTravelDeg, kMostTravelDeg);
  const bool turns = least <= 0.0 && most >= 0.0 && (most >= kSmallTurnDeg || least <= -kSmallTurnDeg);
  if (!turns)
    throw std::invalid_argument(
        fmt::format("{}: found {:g} to {:g}; required: ends on both sides of zero, where the axis is homed, "
                    "and one of them {:g} or more away",
                    what, least, most, kSmallTurnDeg));
  return {Angle::degrees(least), Angle::degrees(most)};
}

std::string_view article(std::string_view role) {
  return role == "accelerometer" ? "an" : "a";
}

std::string_view by_hand_page(const ProbeAnswer& answer) {
  return answer.stage ? "docs/drivers/split_stage.md" : "docs/bench_file.md";
}

}  // namespace

std::array<AxisTravel, 2> parse_travel(std::string_view text) {
  const auto axes = pieces::split(text, ',');
  if (axes.size() > 2)
    throw std::invalid_argument(
        fmt::format("travel: found \"{}\"; required: \"MIN MAX\" for both axes, or \"MIN MAX, MIN MAX\" for "
                    "X and Z, with decimal points",
                    text));
  return {axis_travel(axes.front(), "X"), axis_travel(axes.back(), "Z")};
}

PlaceAnswer parse_place(std::string_view text) {
  auto words = pieces::words(text);
  PlaceAnswer place;
  if (words.size() == 3 && words[0] == "g") {
    place.g_loc_mps2 = number_within(words[1], "local gravity (m/s2)", 9.5, 10.0);
    constexpr double kLeastUncertainty = 1e-9;  // m/s2; a survey has an uncertainty.
    place.expanded_uncertainty_mps2 =
        number_within(words[2], "its expanded uncertainty (m/s2)", kLeastUncertainty, 1.0);
    return place;
  }
  if (words.size() == 2) {
    if (words[0].ends_with(',')) words[0].remove_suffix(1);  // "52.3, 80"
    place.latitude_deg = number_within(words[0], "latitude (degree, south negative)", -90.0, 90.0);
    place.height_m = number_within(words[1], "height above sea level (m)", -500.0, 9000.0);
    return place;
  }
  throw std::invalid_argument(
      fmt::format("place: found \"{}\"; required: latitude in degrees and height in metres, as \"52.3 80\", "
                  "or a survey's value with its expanded uncertainty in m/s2, as \"g 9.81234 0.00002\"",
                  pieces::trimmed(text)));
}

std::string gravity_by_formula(const PlaceAnswer& place) {
  const FormulaGravity gravity =
      formula_gravity(Angle::degrees(place.latitude_deg.value()), place.height_m.value());
  return fmt::format("gravity {:.5f} m/s2 by formula, U = {:.5f} m/s2", gravity.value_mps2,
                     2.0 * gravity.standard_uncertainty_mps2);
}

std::string parse_operator(std::string_view text) {
  const std::string name(pieces::trimmed(text));
  const bool has_controls = std::ranges::any_of(name, [](unsigned char c) { return c < 0x20 || c == 0x7f; });
  const bool has_letters =  // Beyond ASCII nearly all are.
      std::ranges::any_of(name, [](unsigned char c) { return std::isalpha(c) != 0 || c >= 0x80; });
  if (!has_letters || has_controls || name.size() > 200 || valid_text(name) != name)
    throw std::invalid_argument(
        "operator: required: the name of the person who measures, in letters, at most 200 characters");
  return name;
}

std::array<std::string, 2> parse_axes(std::string_view text) {
  const auto words = pieces::words(text, " \t,");
  if (words.size() != 2 || words[0] == words[1])
    throw std::invalid_argument(fmt::format(
        "axes: found \"{}\"; required: the controller's names of the outer and the inner axis, as \"1 2\"",
        text));
  return {std::string(words[0]), std::string(words[1])};
}

bool parse_yes_or_no(std::string_view text) {
  const std::string_view word = pieces::trimmed(text);
  for (const std::string_view yes : {"yes", "Yes", "YES", "y", "Y"})
    if (word == yes) return true;
  for (const std::string_view no : {"no", "No", "NO", "n", "N"})
    if (word == no) return false;
  throw std::invalid_argument(fmt::format("found \"{}\"; required: yes or no", word));
}

std::vector<Probed> candidates(const std::vector<Probed>& probed, std::string_view role) {
  std::vector<Probed> list;
  for (const Probed& each : probed) {
    if (each.answer && !each.answer->driver.empty() && each.answer->role() == role) list.push_back(each);
  }
  return list;
}

std::optional<Probed> chosen(const std::vector<Probed>& list, std::string_view answer) {
  const std::string_view word = pieces::trimmed(answer);
  if (word.empty()) {
    if (list.size() == 1) return list.front();
    throw std::invalid_argument(
        list.empty() ? "none answers; required: a port"
                     : fmt::format("{} answer; required: one of their numbers, or a port", list.size()));
  }
  for (const Probed& each : list)
    if (each.port == word) return each;
  if (!std::ranges::all_of(word, [](char c) { return c >= '0' && c <= '9'; })) return std::nullopt;
  std::size_t n = 0;
  std::from_chars(word.data(), word.data() + word.size(), n);
  if (n < 1 || n > list.size())
    throw std::invalid_argument(
        list.empty() ? fmt::format("found \"{}\"; required: a port", word)
                     : fmt::format("found \"{}\"; required: 1 to {}, or a port", word, list.size()));
  return list[n - 1];
}

void require_role(const Probed& probed, std::string_view role) {
  const std::string who = fmt::format("{} on {}", role, probed.port);
  if (!probed.failure.empty()) {
    // Most begin as this error does: "PORT: cannot open: ".
    const std::string same = fmt::format("{}: {}: ", probed.port, to_string(Fault::kCannotOpen));
    throw InstrumentError(
        who, Fault::kCannotOpen,
        probed.failure.starts_with(same) ? probed.failure.substr(same.size()) : probed.failure);
  }
  if (!probed.answer || probed.answer->driver.empty())
    throw InstrumentError(
        who, Fault::kNoReply,
        in_words(probed) +
            "; required: an instrument of a driver that `abcal instruments` lists, switched on");
  if (probed.answer->role() != role)
    throw InstrumentError(
        who, Fault::kWrongIdentity,
        fmt::format("{} {} answers, {} {}; required: {} {}", article(probed.answer->role()),
                    probed.answer->role(), probed.answer->maker, probed.answer->model, article(role), role));
  if (probed.answer->ports > 1)
    throw InstrumentError(
        who, Fault::kWrongIdentity,
        fmt::format("it is one of {} of its kind that measure together; required: an instrument with one "
                    "port, or a bench file that is written by hand ({})",
                    probed.answer->ports, by_hand_page(*probed.answer)));
}

std::array<std::string, 2> axes_of(const ProbeAnswer& stage,
                                   const std::optional<std::array<std::string, 2>>& given) {
  const std::vector<std::string>& found = stage.axes;
  if (given) {
    for (const std::string& axis : *given) {
      if (!found.empty() && std::ranges::find(found, axis) == found.end())
        throw std::invalid_argument(fmt::format(
            "--axes: found \"{}\"; required: two of the axes on the port: {}", axis, fmt::join(found, ", ")));
    }
    return *given;
  }
  if (found.empty()) {
    const StageAxisConfig x = StageConfig().x, z = StageConfig().z;
    return {x.axis, z.axis};
  }
  if (found.size() == 2) return {found[0], found[1]};
  throw std::invalid_argument(fmt::format(
      "the stage has {} on its port: {}; required: {}", found.size() == 1 ? "one axis" : "several axes",
      fmt::join(found, ", "),
      found.size() == 1
          ? std::string("two, or a bench file for two controllers (docs/drivers/split_stage.md)")
          : "the names of the outer and the inner one, as --axes \"" + found[0] + " " + found[1] + "\""));
}

std::string stable_port_name(const std::string& port, const std::vector<wire::PortInfo>& listed) {
  for (const wire::PortInfo& each : listed) {
    if (each.path != port) continue;
    const std::string usb = usb_name(each);
    const auto of_the_same_name =
        std::ranges::count_if(listed, [&](const wire::PortInfo& other) { return usb_name(other) == usb; });
    if (!usb.empty() && of_the_same_name == 1) return usb;
    return each.by_id.empty() ? each.path : each.by_id;
  }
  if (wire::parse_port(port).kind != wire::PortName::Kind::kPath) return port;
  return std::filesystem::absolute(port).lexically_normal().string();
}

std::vector<std::string> ports_for(const std::vector<std::string>& given, std::size_t wanted,
                                   const std::vector<wire::PortInfo>& listed) {
  std::vector<std::string> ports = given;
  if (given.size() >= wanted) return ports;
  const auto is_given = [&](const std::string& path) {
    return std::ranges::any_of(given, [&](const std::string& name) {
      std::error_code ignored;
      return name == path || std::filesystem::equivalent(name, path, ignored) ||
             std::ranges::any_of(listed, [&](const wire::PortInfo& each) {
               return each.path == path && usb_name(each) == name;
             });
    });
  };
  for (const std::string& path : ports_to_ask(listed))
    if (!is_given(path)) ports.push_back(path);
  return ports;
}

}  // namespace abcal
