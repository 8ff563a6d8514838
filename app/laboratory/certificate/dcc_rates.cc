#include "app/laboratory/certificate/dcc_rates.h"

#include <fmt/format.h>

#include <string>
#include <vector>

#include "app/laboratory/certificate/dcc_quantity.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dsi_list.h"

namespace abcal {
namespace {

/// Four significant digits: more than the clocks of instruments leave unknown.
std::string rounded(double value) {
  return dsi_number(std::stod(fmt::format("{:.3e}", value)), "frequency");
}

void add_turn(XmlElement& list, const std::string& ref_type, const Wording& name, double value,
              const std::string& unit) {
  XmlElement real = add_quantity(list, ref_type, name).add("si:real");
  real.add("si:value", rounded(value));
  real.add("si:unit", unit);
}

/// A list of what no scope covers: a scope states sensitivities at rest, angles and offsets.
ValueList outside_of_scope(const StatedResult& stated, ValueList list) {
  if (!stated.marks.empty()) list.marks.assign(list.labels.size(), ScopeMark::kOutside);
  return list;
}

}  // namespace

void add_response_at_rates(XmlElement& results, const Words& words, const StatedResult& stated) {
  if (!stated.result.joint || !stated.result.joint->motion) return;
  XmlElement data = add_result(
      results, "abc_responseAtRates", words("Response at constant rates"),
      words("Response to gravity that turns once a period: its amplitude, relative to that at rest, and its "
            "phase beyond that of a delay that is the same at all rates; above 0 it leads. Frequencies are "
            "those of the turning stage by the clock of the computer, without an uncertainty and not "
            "traceable. "
            "All other results are those at rest."));
  int number = 0;
  for (const RateResponse& response : stated.result.joint->motion->responses) {
    XmlElement list = data.add("dcc:list");
    list.attribute("refType", "abc_responseAtRate");
    add_words(list, "dcc:name", words("Response at rate {rate}", ++number));
    add_turn(list, "abc_rate", words("Rate of the turn"), response.rate_deg_per_s, kDegreesPerSecond);
    add_turn(list, "abc_frequency", words("Frequency"), response.frequency_hz, "\\hertz");
    add_list(list, words, words("Amplitude relative to that at rest"),
             outside_of_scope(stated, list_of({"A_u", "A_v", "A_w"},
                                              {response.amplitude.begin(), response.amplitude.end()})));
    add_list(list, words, words("Phase beyond a delay"),
             outside_of_scope(stated, list_of({"theta"}, {response.phase})));
  }
}

}  // namespace abcal
