#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "app/measure/bench/probe_ports.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal {

/// The place of the bench, or its local gravity.
struct PlaceAnswer {
  std::optional<double> latitude_deg, height_m;
  std::optional<double> g_loc_mps2, expanded_uncertainty_mps2;  ///< U, k = 2
};

// Each reads the answer to a question of `abcal init`, at the terminal or as an option.
// @throws std::invalid_argument  what was found and what is required

/// "-100 365" for both axes, or "-100 365, -5 400" for X and Z: degrees as the controllers count, from where
/// the axes are homed. Zero and 30 degrees on one side must be inside.
std::array<AxisTravel, 2> parse_travel(std::string_view text);

/// "52.3 80": geodetic latitude (degree, south negative) and height above sea level (m); or
/// "g 9.81234 0.00002": a survey's value and its expanded uncertainty (m/s2, k = 2).
PlaceAnswer parse_place(std::string_view text);

/// A person's name: some letters, no control characters.
std::string parse_operator(std::string_view text);

/// "1 2": the controller's names of the outer and the inner axis.
std::array<std::string, 2> parse_axes(std::string_view text);

/// "gravity 9.81249 m/s2 by formula, U = 0.00057 m/s2", at a latitude and a height.
/// @throws std::bad_optional_access for a place without them
std::string gravity_by_formula(const PlaceAnswer& place);

/// true for "yes", false for "no", also "y" and "n", and in capitals.
bool parse_yes_or_no(std::string_view text);

/// The instruments of a role among those that answered and that init can describe.
/// @param role  "stage" or "accelerometer", as ProbeAnswer::role()
std::vector<Probed> candidates(const std::vector<Probed>& probed, std::string_view role);

/// The instrument that an answer means by its number in the list ("2"), by its port, or by an empty answer if
/// it is the only one.
/// @return nullopt if the answer names another port
std::optional<Probed> chosen(const std::vector<Probed>& list, std::string_view answer);

/// Refuses an instrument that init cannot use in a role, with the reason and what to do.
/// @throws InstrumentError
void require_role(const Probed& probed, std::string_view role);

/// The two axes of a stage, outer first: those given, else the only two that its controllers have on the
/// line.
/// @param given  as parse_axes(); absent: not given
/// @throws std::invalid_argument if there are more, or one
std::array<std::string, 2> axes_of(const ProbeAnswer& stage,
                                   const std::optional<std::array<std::string, 2>>& given);

/// The port as a bench file names it best: by the identity of its USB device if no other port has the same,
/// else by a path that stays; a relative path becomes absolute.
std::string stable_port_name(const std::string& port, const std::vector<wire::PortInfo>& listed);

/// The ports to ask: those that `given` names; where one of two is not given, all free ports too, each once.
std::vector<std::string> ports_for(const std::vector<std::string>& given, std::size_t wanted,
                                   const std::vector<wire::PortInfo>& listed);

}  // namespace abcal
