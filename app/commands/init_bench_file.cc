#include "app/commands/init_bench_file.h"

#include <fmt/format.h>

#include <algorithm>

#include "app/commands/toml_string.h"
#include "drivers/instrument/angle.h"

namespace abcal {
namespace {

/// Any bytes of an instrument or a person as a string of TOML.
std::string quoted(const std::string& text) {
  return toml_string(text, nlohmann::json::error_handler_t::replace);
}

/// A number that a person also reads as one that may have decimals.
std::string decimal(double value) {
  const std::string text = fmt::format("{}", value + 0.0);  // No -0.
  return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
}

/// Text for a comment: one line.
std::string comment(std::string text) {
  std::ranges::replace_if(
      text, [](unsigned char c) { return c < 0x20 || c == 0x7f; }, ' ');
  return text;
}

std::string bench_section(const PlaceAnswer& place) {
  std::string text = "[bench]\n";
  if (place.g_loc_mps2)
    return text + fmt::format(
                      "g_loc_mps2 = {}\n"
                      "g_loc_expanded_uncertainty_mps2 = {}\n"
                      "g_loc_k = 2.0\n"
                      "g_loc_source = \"\"                           # state it: a survey, or the number of "
                      "a certificate\n",
                      decimal(*place.g_loc_mps2), decimal(*place.expanded_uncertainty_mps2));
  return text + fmt::format(
                    "latitude_deg = {}\n"
                    "height_m = {}\n"
                    "# From these: {} (`abcal gravity`). A sensitivity per m/s2 needs a survey:\n"
                    "# g_loc_mps2, g_loc_expanded_uncertainty_mps2, g_loc_k and g_loc_source instead.\n",
                    decimal(*place.latitude_deg), decimal(*place.height_m), gravity_by_formula(place));
}

std::string item_section(const BenchDraft& draft) {
  std::string text = "\n[item]\n";
  const bool is_reported = !draft.item.serial_number.empty() || !draft.item.model.empty();
  if (is_reported) {
    text +=
        "# As the instrument reports it. Another maker, model or serial number is refused: leave it empty to "
        "take any.\n";
    text += fmt::format("maker = {}\nmodel = {}\nserial_number = {}\n", quoted(draft.item.maker),
                        quoted(draft.item.model), quoted(draft.item.serial_number));
  } else {
    text +=
        "# The instrument does not report which item it is: read the label.\n"
        "maker = \"\"\nmodel = \"\"\nserial_number = \"\"\n";
  }
  if (!draft.learned) return text;
  const LearnedMounting& learned = *draft.learned;
  return text + fmt::format(
                    "{:<43} # axes of the platter along which u, v, w point: the nearest of 24;\n"
                    "                                            # the item is turned by {:.1f} degrees from "
                    "it, which a run measures\n",
                    "mounting = " + quoted(learned.mounting), learned.tilt.deg());
}

std::string axis_section(const char* name, const std::string& axis, const AxisTravel& controller_travel,
                         int sign, const std::string& why) {
  const AxisTravel travel = in_protocol_angles(controller_travel, sign);
  return fmt::format(
      "[stage.{}]{}\n"
      "axis = {}\n"
      "sign = {:<2}                                   {}\n"
      "zero_deg = 0.0                              # where the axis is homed; `abcal level` measures it\n"
      "travel_min_deg = {:<26} # limits of the cable, as stated{}\n"
      "travel_max_deg = {}\n",
      name,
      name[0] == 'x' ? "                                   # the outer, horizontal axis"
                     : "                                   # the inner axis, which X carries",
      quoted(axis), sign, why, decimal(travel.min.deg()),
      sign > 0 ? "" : "; with sign = -1 they are those of the controller, mirrored",
      decimal(travel.max.deg()));
}

std::string stage_sections(const BenchDraft& draft) {
  std::string text =
      fmt::format("\n[stage]                                     # {}\ndriver = {}\nport = {}\n",
                  comment(draft.stage_name), quoted(draft.stage_driver), quoted(draft.stage_port));
  const int sign_x = draft.learned ? draft.learned->sign_x : +1;
  const int sign_z = draft.learned ? draft.learned->sign_z : +1;
  const bool is_sign_x_known = draft.learned && draft.learned->is_sign_x_known;
  text +=
      axis_section("x", draft.axes[0], draft.travel[0], sign_x,
                   is_sign_x_known ? "# learned from gravity and from how the item stands, as stated"
                                   : "# 1 by definition: +x of the platter is where X turns right-handed;\n"
                                     "                                            # if +x is marked the "
                                     "other way: `abcal init --mounting`");
  return text + axis_section("z", draft.axes[1], draft.travel[1], sign_z,
                             "# learned from gravity, for outputs that are right-handed");
}

std::string accelerometer_section(const BenchDraft& draft) {
  std::string text =
      fmt::format("\n[accelerometer]                             # {}\ndriver = {}\nport = {}\n",
                  comment(draft.accelerometer_name), quoted(draft.accelerometer_driver),
                  quoted(draft.accelerometer_port));
  text += "rate_hz = 100.0                             # readings per second\n";
  if (!draft.response_unit.empty()) text += fmt::format("response_unit = {}\n", quoted(draft.response_unit));
  return text;
}

constexpr const char* kUsualProtocol = R"(
[protocol]                                  # `abcal plan FILE --reach` finds the shortest one for a wanted uncertainty
steps = 72                                  # angles of each of the three experiments
step_deg = 5.0
settle_s = "auto"                           # from stopped to the first reading that counts: as long as the outputs need
dwell_readings = 1000                       # averaged at each angle
# mains_hz = 50.0                           # or 60.0: each dwell lasts a whole number of mains periods
warm_up_s = 1800.0                          # waited with everything on; a check does not wait
stability_s = 60.0                          # then wait until outputs and temperature are stable for this time
)";

constexpr const char* kSizes = R"(
# Sizes of the errors of stage and item, as standard uncertainties with their sources, for example
#   alignment_deg = { value = 0.008, source = "data sheet: orthogonality" }
# None is stated yet, so all are defaults: results say so, and a certificate needs them. docs/effects.md shows how to find them.
[stage_uncertainty]
[item_uncertainty]
)";

}  // namespace

AxisTravel in_protocol_angles(const AxisTravel& travel, int sign) {
  return sign > 0 ? travel : AxisTravel{travel.max * -1, travel.min * -1};
}

std::string bench_draft_text(const BenchDraft& draft) {
  std::string text = fmt::format(
      "# {}\n"
      "# Every key: docs/bench_file.md. `abcal plan FILE` checks the file without contacting an instrument.\n"
      "# A software halt is not an emergency stop: keep the stage's own switch within reach.\n"
      "schema = \"abcal.bench/2\"\n\n",
      comment(draft.made));
  text += bench_section(draft.place) + item_section(draft);
  text += fmt::format("\n[operator]\nname = {}\n", quoted(draft.operator_name));
  text += stage_sections(draft) + accelerometer_section(draft);
  text += draft.emulated.empty() ? kUsualProtocol : "\n" + draft.emulated;
  return text + kSizes;
}

}  // namespace abcal
