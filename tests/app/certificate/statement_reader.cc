#include "tests/app/certificate/statement_reader.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <sstream>
#include <stdexcept>
#include <utility>
#include <variant>

#include "app/formats/xml_query.h"

namespace abcal::test {
namespace {

constexpr double kStandard = 9.80665;
constexpr const char* kNone = "none possible";
constexpr double kDegreeInRad = std::numbers::pi / 180.0;

void replace(std::string& text, const std::string& from, const std::string& to) {
  for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
    text.replace(at, from.size(), to);
}

/// "-1.20e-05" with its digit 1e-7.
PrintedNumber printed(const std::string& text) {
  const std::size_t e = std::min(text.find('e'), text.size()), point = text.find('.');
  const double power = e < text.size() ? std::stod(text.substr(e + 1)) : 0.0;
  const double decimals = point < e ? static_cast<double>(e - point - 1) : 0.0;
  return {std::stod(text), std::pow(10.0, power - decimals)};
}

PrintedNumber times(PrintedNumber number, double factor) {
  return {number.value * factor, number.digit * std::abs(factor)};
}

// ---- the XML
// ------------------------------------------------------------------------------------------------

/// Units that statements of the certificate define, and those of D-SI.
class UnitsOfXml {
 public:
  UnitsOfXml(const XmlQuery& xml, double g_loc) : g_loc_(g_loc) {
    for (xmlNode* statement : xml.nodes("//dcc:statement[dcc:nonSIUnit]"))
      definitions_[xml.text("dcc:nonSIUnit", statement)] = xml.text("dcc:nonSIDefinition", statement);
  }

  double factor(const std::string& unit) const {
    if (!unit.starts_with('|')) return factor_of_d_si(unit);
    const auto found = definitions_.find(unit);
    if (found == definitions_.end()) throw std::runtime_error("unit " + unit + " is defined nowhere");
    const std::string& words = found->second;
    if (unit.ends_with("/g_loc")) return output_factor(unit.substr(1, unit.size() - 7)) / g_loc_;
    const std::size_t at = words.find("= ");
    if (at == std::string::npos) throw std::runtime_error("no number in the definition \"" + words + "\"");
    std::string number = words.substr(at + 2);
    // The decimal mark of the language.
    if (const std::size_t comma = number.find(','); comma + 1 < number.size() && number[comma + 1] != ' ')
      number[comma] = '.';
    const double factor = std::stod(number);
    // "= 0.102 mV/(m/s2) (g_n = ...)", or "= 0.001, a plain number in SI units".
    return unit.ends_with("/g_n")
               ? factor * prefix_of(number.substr(std::min(number.find(' ') + 1, number.size())))
               : factor;
  }

 private:
  static double output_factor(const std::string& output) {
    if (output == "g") return kStandard;
    if (output == "mg") return 1e-3 * kStandard;
    return prefix_of(output);
  }
  static double prefix_of(const std::string& output) {
    return output.starts_with("mV") ? 1e-3 : output.starts_with("uV") ? 1e-6 : 1.0;
  }

  double g_loc_;
  std::map<std::string, std::string> definitions_;
};

/// "g_loc*s_ux[|g]" as "g_loc*sensitivity_ux"; other names stay.
std::string name_of(std::string label) {
  label = label.substr(0, label.find('['));
  std::string before;
  if (label.starts_with("g_loc*")) {
    before = "g_loc*";
    label = label.substr(6);
  }
  const std::size_t at = label.find('_');
  if (at == std::string::npos) return before + label;
  const std::string symbol = label.substr(0, at), of = label.substr(at);
  if (symbol == "s") return before + (of.size() == 3 ? "sensitivity" : "intrinsic_sensitivity") + of;
  if (symbol == "phi") return before + "intrinsic_angle" + of;
  if (symbol == "O") return before + "offset" + of;
  return before + label;
}

class XmlReader {
 public:
  explicit XmlReader(const std::string& text)
      : document_(parse_xml(text, "certificate")),
        xml_(document_.get()),
        g_loc_(local_gravity()),
        units_(xml_, g_loc_.value) {}

  double unit_factor(const std::string& unit) const { return units_.factor(unit); }

  Reading read(bool last) {
    Reading reading;
    reading.g_loc_mps2 = g_loc_.value;
    const auto all = xml_.nodes("dcc:measurementResults/dcc:measurementResult[@refType='abc_calibration']");
    reading.calibrations = static_cast<int>(all.size());
    xmlNode* calibration = last ? all.back() : all.front();
    for (xmlNode* result : xml_.nodes("dcc:results/dcc:result", calibration)) {
      const std::string type = xml_.text("@refType", result);
      if (type == "abc_state" || type == "abc_budget" || type == "abc_shift") continue;
      for (xmlNode* quantity : xml_.nodes("dcc:data/dcc:quantity | dcc:data/dcc:list/dcc:quantity", result)) {
        read_quantity(quantity, "XML " + type, reading);
        if (type == "abc_conformity") read_decision(quantity, reading);
      }
    }
    read_budget(calibration, reading);
    reading.marked_outside = static_cast<int>(
        xml_.nodes("dcc:results//dcc:metaData[@refType='abc_outsideScope']", calibration).size());
    reading.marked_raised = static_cast<int>(
        xml_.nodes("dcc:results//dcc:metaData[@refType='abc_raisedToScope']", calibration).size());
    return reading;
  }

 private:
  PrintedNumber local_gravity() const {
    return printed(xml_.text("//dcc:influenceCondition[@refType='abc_localGravity']//si:value"));
  }

  static std::string at(const std::vector<std::string>& list, std::size_t i) {
    return list.empty() ? std::string() : list.size() == 1 ? list.front() : list.at(i);
  }

  void read_quantity(xmlNode* quantity, const std::string& where, Reading& reading) const {
    for (xmlNode* list : xml_.nodes("si:realListXMLList | si:hybrid/si:realListXMLList", quantity)) {
      const auto values = xml_.words("si:valueXMLList", list), labels = xml_.words("si:labelXMLList", list),
                 units = xml_.words("si:unitXMLList", list),
                 expanded = xml_.words(".//si:valueExpandedMUXMLList", list),
                 factors = xml_.words(".//si:expandedMUXMLList/si:coverageFactorXMLList", list);
      for (std::size_t i = 0; i < values.size(); ++i) {
        const double unit = units_.factor(at(units, i));
        reading.claims.push_back({where, name_of(labels.at(i)), times(printed(values[i]), unit),
                                  times(printed(at(expanded, i)), unit), at(factors, i), ""});
      }
      compare_covariance(list, labels, {expanded, factors}, reading);
    }
    // In a hybrid the first has the verdict.
    std::string verdict = xml_.text("dcc:measurementMetaData/dcc:metaData/dcc:conformity", quantity);
    if (verdict.empty() && where == "XML abc_conformity") verdict = kNone;
    for (xmlNode* real : xml_.nodes("si:real | si:hybrid/si:real", quantity)) {
      const double unit = units_.factor(xml_.text("si:unit", real));
      reading.claims.push_back({where, name_of(xml_.text("dcc:name/dcc:content", quantity)),
                                times(printed(xml_.text("si:value", real)), unit),
                                times(printed(xml_.text(".//si:valueExpandedMU", real)), unit),
                                xml_.text(".//si:coverageFactor", real), std::exchange(verdict, "")});
    }
  }

  /// Variances of a list are those of its U/k.
  void compare_covariance(xmlNode* list, const std::vector<std::string>& labels,
                          const std::pair<std::vector<std::string>, std::vector<std::string>>& uncertainty,
                          Reading& reading) const {
    const auto columns = xml_.nodes(".//si:columnXMLList", list);
    for (std::size_t i = 0; i < columns.size(); ++i) {
      const double variance = std::stod(xml_.words("si:covarianceXMLList/si:valueXMLList", columns[i]).at(i));
      const PrintedNumber expanded = printed(at(uncertainty.first, i));
      const double k = std::stod(at(uncertainty.second, i));
      // k has two decimals.
      if (std::abs(k * std::sqrt(variance) - expanded.value) > 0.51 * expanded.digit + 0.003 * expanded.value)
        reading.contradictions.push_back(
            fmt::format("{}: U = {} with k = {}, but the covariance gives u = {}", labels[i], expanded.value,
                        k, std::sqrt(variance)));
    }
  }

  std::optional<PrintedNumber> limit(xmlNode* facts, const std::string& type, bool last) const {
    const auto found = xml_.nodes("dcc:data/dcc:quantity[@refType='basic_" + type + "']//si:real", facts);
    if (found.empty()) return std::nullopt;
    xmlNode* real = last ? found.back() : found.front();
    return times(printed(xml_.text("si:value", real)), units_.factor(xml_.text("si:unit", real)));
  }

  /// Whether value lies within limits. @param digit  of the value, in which the comparison is made
  static bool within(const PrintedNumber& value, const std::optional<PrintedNumber>& low,
                     const std::optional<PrintedNumber>& high) {
    return (!low || value.value >= low->value - 1e-3 * value.digit) &&
           (!high || value.value <= high->value + 1e-3 * value.digit);
  }

  /// The verdict is that of the numbers, and the stated limit is the converted one.
  void read_decision(xmlNode* quantity, Reading& reading) const {
    ++reading.decisions;
    const std::string name = xml_.text("dcc:name/dcc:content", quantity);
    xmlNode* facts =
        xml_.nodes("dcc:measurementMetaData/dcc:metaData[@refType='basic_conformity']", quantity).front();
    for (const char* type : {"toleranceLimitLower", "toleranceLimitUpper"}) {
      const auto si = limit(facts, type, false), stated = limit(facts, type, true);
      // Twelve digits of a limit; local gravity as it is printed.
      const double allowed = 1e-9 + 0.5 * g_loc_.digit / g_loc_.value;
      if (si && std::abs(si->value - stated->value) > allowed * std::abs(si->value))
        reading.contradictions.push_back(
            fmt::format("{}: limit {} in SI units, {} as stated", name, si->value, stated->value));
    }
    xmlNode* real = xml_.nodes("si:real | si:hybrid/si:real", quantity).front();
    const PrintedNumber value =
        times(printed(xml_.text("si:value", real)), units_.factor(xml_.text("si:unit", real)));
    const bool accepted = within(value, limit(facts, "acceptanceLimitLower", false),
                                 limit(facts, "acceptanceLimitUpper", false));
    const bool tolerated =
        within(value, limit(facts, "toleranceLimitLower", false), limit(facts, "toleranceLimitUpper", false));
    const std::string verdict = xml_.text("dcc:conformity", facts);
    if (verdict.empty()) return;  // no decision: no acceptance limit either
    const bool agrees = accepted ? verdict == "pass"
                                 : verdict == "fail" || (tolerated ? verdict == "conditionalPass"
                                                                   : verdict == "conditionalFail");
    if (!agrees)
      reading.contradictions.push_back(fmt::format("{} = {}: {}, but accepted = {}, tolerated = {}", name,
                                                   value.value, verdict, accepted, tolerated));
  }

  /// The root of the sum of squares of each output is its U/k, as far as the printed digits of both tell.
  void read_budget(xmlNode* measurement, Reading& reading) const {
    std::map<std::string, std::pair<double, double>> squares;  // Smallest and largest.
    for (xmlNode* line :
         xml_.nodes("dcc:results/dcc:result[@refType='abc_budget']/dcc:data/dcc:list", measurement)) {
      ++reading.budget_lines;
      for (xmlNode* list :
           xml_.nodes("dcc:quantity[@refType='abc_contribution']//si:realListXMLList", line)) {
        const auto labels = xml_.words("si:labelXMLList", list), values = xml_.words("si:valueXMLList", list);
        const double unit = units_.factor(xml_.text("si:unitXMLList", list));
        for (std::size_t i = 0; i < labels.size(); ++i) {
          const PrintedNumber part = times(printed(values[i]), unit);
          auto& [low, high] = squares[name_of(labels[i])];
          low += std::pow(std::max(0.0, std::abs(part.value) - 0.5 * part.digit), 2);
          high += std::pow(std::abs(part.value) + 0.5 * part.digit, 2);
        }
      }
    }
    for (const auto& [name, limits] : squares) {
      const auto claim = std::find_if(reading.claims.begin(), reading.claims.end(),
                                      [&, of = name](const Claim& each) { return each.quantity == of; });
      const double k = std::stod(claim->factor);
      // k has two decimals.
      const double least = (claim->expanded.value - 0.5 * claim->expanded.digit) / (k + 0.005),
                   most = (claim->expanded.value + 0.5 * claim->expanded.digit) / (k - 0.005);
      if (std::sqrt(limits.first) > most || std::sqrt(limits.second) < least)
        reading.contradictions.push_back(fmt::format("{}: u = {} to {}, but its budget gives {} to {}", name,
                                                     least, most, std::sqrt(limits.first),
                                                     std::sqrt(limits.second)));
    }
  }

  XmlDocument document_;
  XmlQuery xml_;
  PrintedNumber g_loc_;
  UnitsOfXml units_;
};

// ---- pages and text
// -----------------------------------------------------------------------------------------

/// A number as pages show it: "−1,20 × 10⁻⁵" as "-1.20e-5"; nothing for another text.
std::optional<std::string> plain_number(std::string text) {
  replace(text, "−", "-");
  replace(text, ",", ".");
  if (const std::size_t at = text.find(" × 10"); at != std::string::npos) {
    std::string power = text.substr(at + std::string(" × 10").size());
    int n = 0;
    for (const char* digit : {"⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"})
      replace(power, digit, std::to_string(n++));
    replace(power, "⁻", "-");
    text = text.substr(0, at) + "e" + power;
  }
  if (text.empty() || text.find_first_not_of("-+.e0123456789") != std::string::npos ||
      text.find_first_of("0123456789") == std::string::npos)
    return std::nullopt;
  return text;
}

/// A unit as pages show it, per the SI unit.
double page_factor(std::string unit, double g_loc) {
  const bool is_per_gravity = unit.ends_with("/gₙ") || unit.ends_with("/g_n") || unit.ends_with("/gn") ||
                              unit.ends_with("/g_loc") || unit.ends_with("/gloc");
  // An element of the customer's equation: an acceleration per output.
  for (const auto& [begin, end] :
       {std::pair<std::string, std::string>{"(m/s²)/(", ")"}, {"(m/s²)/", ""}, {"m s⁻² ", "⁻¹"}})
    if (unit.starts_with(begin) && unit.ends_with(end) && !is_per_gravity)
      return 1.0 / page_factor(unit.substr(begin.size(), unit.size() - begin.size() - end.size()), g_loc);
  double per = 1.0;
  replace(unit, "gₙ", "g_n");
  for (const auto& [suffix, acceleration] : {std::pair{std::string("/(m/s²)"), 1.0},
                                             {"/g_n", kStandard},
                                             {"/gn", kStandard},
                                             {"/g_loc", g_loc},
                                             {"/gloc", g_loc}}) {
    if (!unit.ends_with(suffix)) continue;
    per = acceleration;
    unit.resize(unit.size() - suffix.size());
    break;
  }
  if (unit.starts_with('(') && unit.ends_with(')')) unit = unit.substr(1, unit.size() - 2);
  static const std::map<std::string, double> kUnits{
      {"1", 1.0},     {"", 1.0},    {"V", 1.0},       {"mV", 1e-3},
      {"µV", 1e-6},   {"uV", 1e-6}, {"g", kStandard}, {"mg", 1e-3 * kStandard},
      {"m/s²", 1.0},  {"LSB", 1.0}, {"%", 1e-2},      {"°", kDegreeInRad},
      {"mrad", 1e-3}, {"m/s2", 1.0}};
  const auto found = kUnits.find(unit);
  if (found == kUnits.end()) throw std::runtime_error("a page has the unit \"" + unit + "\"");
  return found->second / per;
}

/// "s_ux", "g_loc·s_u", "bias u *", "Nullpunktbeschleunigung u" as the quantity; empty: none.
std::string page_quantity(std::string text) {
  if (text.ends_with("*")) text.pop_back();  // Outside the scope.
  if (text.ends_with(" ")) text.pop_back();
  replace(text, "·", "*");
  replace(text, "φ", "phi");
  if (text.find(' ') == std::string::npos) {
    // Text of pages has no underscore: an index is set lower.
    replace(text, "gloc", "g_loc");
    for (const std::string symbol : {"phi", "s", "O"}) {
      const std::string before = text.starts_with("g_loc*") ? "g_loc*" : "";
      const std::string rest = text.substr(before.size());
      if (rest.starts_with(symbol) && rest.size() > symbol.size() && rest.find('_') == std::string::npos)
        return name_of(before + symbol + "_" + rest.substr(symbol.size()));
    }
    const std::string name = name_of(text);
    return name == text ? std::string() : name;  // The first word of a name that goes on in the line below.
  }
  static const std::map<std::string, std::string> kWords{
      {"sensitivity", "sensitivity"},
      {"Übertragungskoeffizient", "sensitivity"},
      {"intrinsic sensitivity", "intrinsic_sensitivity"},
      {"intrinsischer Übertragungskoeffizient", "intrinsic_sensitivity"},
      {"intrinsic angle", "intrinsic_angle"},
      {"intrinsischer Winkel", "intrinsic_angle"},
      {"offset", "offset"},
      {"Nullpunktabweichung", "offset"},
      {"transverse sensitivity", "transverse_sensitivity"},
      {"Querempfindlichkeit", "transverse_sensitivity"},
      {"transverse azimuth", "transverse_azimuth"},
      {"Richtung der Querempfindlichkeit", "transverse_azimuth"},
      {"misalignment", "misalignment"},
      {"Fehlausrichtung", "misalignment"},
      {"non orthogonality", "non_orthogonality"},
      {"Abweichung von der Orthogonalität", "non_orthogonality"},
      {"bias", "bias"},
      {"Nullpunktbeschleunigung", "bias"}};
  const std::size_t last = text.rfind(' ');
  const auto found = kWords.find(text.substr(0, last));
  return found == kWords.end() ? std::string() : found->second + "_" + text.substr(last + 1);
}

std::string verdict_of(const std::string& words) {
  static const std::map<std::string, std::string> kVerdicts{{"pass", "pass"},
                                                            {"bestanden", "pass"},
                                                            {"conditionalPass", "conditionalPass"},
                                                            {"bedingt bestanden", "conditionalPass"},
                                                            {"conditionalFail", "conditionalFail"},
                                                            {"bedingt nicht bestanden", "conditionalFail"},
                                                            {"fail", "fail"},
                                                            {kNone, kNone},
                                                            {"nicht möglich", kNone},
                                                            {"nicht bestanden", "fail"}};
  const auto found = kVerdicts.find(words);
  return found == kVerdicts.end() ? std::string() : found->second;
}

/// Adds the statement of a row: quantity, value, U, k, unit, verdict.
void add_claim(const std::array<std::string, 6>& cells, const std::string& where, Reading& reading) {
  const auto& [label, value, expanded, factor, unit, verdict] = cells;
  const auto number = plain_number(value), uncertainty = plain_number(expanded);
  const std::string quantity = page_quantity(label);
  if (!number || !uncertainty || quantity.empty()) {
    reading.contradictions.push_back(
        fmt::format("{}: row \"{}\" {} {} cannot be read", where, label, value, expanded));
    return;
  }
  const double in_si = page_factor(unit, reading.g_loc_mps2);
  std::string k = factor;
  replace(k, ",", ".");
  reading.claims.push_back(
      {where, quantity, times(printed(*number), in_si), times(printed(*uncertainty), in_si), k, verdict});
  if (!verdict.empty()) ++reading.decisions;
}

/// Adds the statements of a row of the customer's equation: "i = x", M_xu and its U, M_xv and its U, M_xw and
/// its U, unit.
void add_equation_claims(const std::vector<std::string>& row, const std::string& where, Reading& reading) {
  constexpr std::string_view kOutputs = "uvw";
  for (std::size_t j = 0; j < kOutputs.size(); ++j) {
    const std::string &value = row.at(1 + 2 * j), &expanded = row.at(2 + 2 * j);
    const auto number = plain_number(value), uncertainty = plain_number(expanded);
    if (!number || !uncertainty || row[0].empty()) {
      reading.contradictions.push_back(
          fmt::format("{}: row \"{}\" {} {} cannot be read", where, row[0], value, expanded));
      continue;
    }
    const double in_si = page_factor(row.at(7), reading.g_loc_mps2);
    const std::string name = fmt::format("M_{}{}", row[0].back(), kOutputs[j]);
    reading.claims.push_back(
        {where, name, times(printed(*number), in_si), times(printed(*uncertainty), in_si), "", ""});
  }
}

bool is_factor(const std::string& text) {
  return text.size() >= 4 && (text[text.size() - 3] == '.' || text[text.size() - 3] == ',') &&
         plain_number(text);
}

/// Words of a line, of which a number with a power of ten is one.
std::vector<std::string> words_of(const std::string& line) {
  std::vector<std::string> words;
  std::istringstream all(line);
  for (std::string word; all >> word;) {
    if (words.size() > 1 && words.back() == "×" && word.starts_with("10")) {
      words.pop_back();
      words.back() += " × " + word;
    } else {
      words.push_back(word);
    }
  }
  return words;
}

std::string joined(const std::vector<std::string>& words, std::size_t from, std::size_t to) {
  std::string text;
  for (std::size_t i = from; i < to; ++i) text += (text.empty() ? "" : " ") + words[i];
  return text;
}

/// The statement of a line. A long name goes on in the lines below.
void read_line(const std::string& line, const std::string& below, Reading& reading) {
  const std::vector<std::string> words = words_of(line);
  constexpr std::size_t kUnitOfEquation = 7;
  if (words.size() > kUnitOfEquation && words[0].starts_with("i=")) {
    std::vector<std::string> row{words[0]};
    row.insert(row.end(), words.begin() + 1, words.begin() + kUnitOfEquation);
    row.push_back(joined(words, kUnitOfEquation, words.size()));
    return add_equation_claims(row, "text", reading);
  }
  for (std::size_t i = 1; i + 2 < words.size(); ++i) {
    if (!plain_number(words[i]) || !plain_number(words[i + 1])) continue;
    std::string label = joined(words, 0, i);
    for (const std::string& more : words_of(below)) {
      if (!page_quantity(label).empty()) break;
      label += " " + more;
    }
    if (page_quantity(label).empty()) return;
    // Quantity, value, U, k, degrees of freedom, unit.
    if (i + 5 == words.size() && is_factor(words[i + 2]) &&
        (words[i + 3] == "∞" || plain_number(words[i + 3])))
      return add_claim({label, words[i], words[i + 1], words[i + 2], words[i + 4], ""}, "text", reading);
    // Quantity, value, U, unit, limits, probability, decision: as many last words as there are of one.
    for (std::size_t n = std::min<std::size_t>(3, words.size() - 1); n >= 1; --n) {
      const std::string verdict = verdict_of(joined(words, words.size() - n, words.size()));
      if (!verdict.empty())
        return add_claim({label, words[i], words[i + 1], "", words[i + 2], verdict}, "text", reading);
    }
    return;
  }
}

bool same(const PrintedNumber& a, const PrintedNumber& b) {
  return std::abs(a.value - b.value) <=
         0.5001 * (a.digit + b.digit) + 1e-9 * std::max(std::abs(a.value), std::abs(b.value));
}

/// An angle and its difference from 90 degrees are one statement.
Reading in_first_terms(Reading reading) {
  const std::string from = "non_orthogonality";
  for (Claim& claim : reading.claims) {
    if (!claim.quantity.starts_with(from)) continue;
    claim.quantity = "intrinsic_angle" + claim.quantity.substr(from.size());
    claim.value.value += 90.0 * kDegreeInRad;
  }
  return reading;
}

std::string disagreement(const Claim& a, const Claim& b) {
  const bool factors = a.factor.empty() || b.factor.empty() || a.factor == b.factor;
  if (a.quantity != b.quantity || (same(a.value, b.value) && same(a.expanded, b.expanded) && factors))
    return "";
  return fmt::format("{}: {} has {:.9g}, U = {:.3g}, k = {}; {} has {:.9g}, U = {:.3g}, k = {}", a.quantity,
                     a.where, a.value.value, a.expanded.value, a.factor, b.where, b.value.value,
                     b.expanded.value, b.factor);
}

}  // namespace

double factor_of_d_si(const std::string& unit) {
  static const std::map<std::string, double> kWords{
      {"milli", 1e-3},         {"micro", 1e-6}, {"one", 1.0},    {"volt", 1.0},   {"ampere", 1.0},
      {"metre", 1.0},          {"second", 1.0}, {"radian", 1.0}, {"kelvin", 1.0}, {"percent", 1e-2},
      {"degree", kDegreeInRad}};
  double factor = 1.0, prefix = 1.0, last = 1.0;
  std::istringstream words(unit);
  for (std::string word; std::getline(words, word, '\\');) {
    if (word.empty()) continue;
    if (word.starts_with("tothe{")) {  // It belongs to the unit before it, prefix included.
      factor *= std::pow(last, std::stoi(word.substr(6)) - 1);
      continue;
    }
    const auto found = kWords.find(word);
    if (found == kWords.end()) throw std::runtime_error("unit " + unit);
    if (word == "milli" || word == "micro") {
      prefix = found->second;
      continue;
    }
    last = prefix * found->second;
    prefix = 1.0;
    factor *= last;
  }
  return factor;
}

Reading read_xml(const std::string& xml, bool last) {
  return in_first_terms(XmlReader(xml).read(last));
}

Reading read_json(const nlohmann::ordered_json& certificate, const std::string& xml, bool last) {
  const XmlReader units(xml);
  std::vector<std::string> calibrations;
  for (const auto& result : certificate.at("results"))
    if (result.at("result") == "abc_sensitivityMatrix") calibrations.push_back(result.at("calibration"));
  Reading reading;
  reading.calibrations = static_cast<int>(calibrations.size());
  for (const auto& result : certificate.at("results")) {
    const std::string type = result.at("result");
    if (type == "abc_shift" ||
        result.at("calibration") != (last ? calibrations.back() : calibrations.front()))
      continue;
    for (const auto& statement : result.at("statements")) {
      const std::string unit = statement.at("unit");
      const double in_si = units.unit_factor(unit);
      // The last digit is that of the printed form, which is the same number. In a hybrid the first has the
      // verdict.
      const auto number = [&](const char* key) {
        const auto as_printed = plain_number(statement.at("printed").at(key));
        if (!as_printed || std::stod(*as_printed) != statement.at(key).get<double>())
          reading.contradictions.push_back(fmt::format("{}: {} is printed as {}", statement.dump(), key,
                                                       as_printed.value_or("no number")));
        return times(printed(as_printed.value_or("0")), in_si);
      };
      const auto& conformity = statement.at("conformity");
      reading.claims.push_back({"JSON " + type, name_of(statement.at("quantity")), number("value"),
                                number("expanded_uncertainty"),
                                fmt::format("{:.2f}", statement.at("coverage_factor").get<double>()),
                                unit.starts_with('|')      ? std::string()
                                : !conformity.is_null()    ? conformity.get<std::string>()
                                : type == "abc_conformity" ? std::string(kNone)
                                                           : std::string()});
      const auto& scope = statement.at("scope");
      reading.marked_outside += scope == "outside" ? 1 : 0;
      reading.marked_raised += scope == "raised" ? 1 : 0;
    }
  }
  return in_first_terms(std::move(reading));
}

Reading read_page(const Document& page, const Reading& xml) {
  Reading reading;
  reading.g_loc_mps2 = xml.g_loc_mps2;
  for (const Section& section : page.sections) {
    for (const Block& block : section.blocks) {
      const auto* table = std::get_if<DocumentTable>(&block);
      if (table == nullptr) continue;
      const std::string where = "page: " + section.title;
      const bool values = table->columns.size() == 6 && table->columns[3].heading == "k",
                 equation = table->columns.size() == 8 && table->columns[1].heading.starts_with("M_"),
                 decisions = table->columns.size() == 9 && table->columns[2].heading == "U";
      for (const std::vector<std::string>& row : table->rows) {
        if (row.size() == 1) continue;
        if (values) add_claim({row[0], row[1], row[2], row[3], row[5], ""}, where, reading);
        if (equation) add_equation_claims(row, where, reading);
        if (decisions) add_claim({row[0], row[1], row[2], "", row[3], verdict_of(row[8])}, where, reading);
      }
    }
  }
  return in_first_terms(std::move(reading));
}

Reading read_text(const std::string& text, const Reading& xml) {
  Reading reading;
  reading.g_loc_mps2 = xml.g_loc_mps2;
  std::vector<std::string> lines;
  std::istringstream all(text);
  for (std::string line; std::getline(all, line);) lines.push_back(line);
  lines.insert(lines.end(), 2, "");
  for (std::size_t i = 0; i + 2 < lines.size(); ++i)
    read_line(lines[i], lines[i + 1] + " " + lines[i + 2], reading);
  return in_first_terms(std::move(reading));
}

std::vector<std::string> disagreements(const std::vector<Claim>& claims) {
  std::vector<std::string> all;
  for (std::size_t i = 0; i < claims.size(); ++i)
    for (std::size_t j = i + 1; j < claims.size(); ++j)
      if (std::string found = disagreement(claims[i], claims[j]); !found.empty())
        all.push_back(std::move(found));
  return all;
}

std::vector<std::string> not_stated(const std::vector<Claim>& claims,
                                    const std::vector<Reading>& calibrations) {
  std::vector<std::string> all;
  for (const Claim& claim : claims) {
    std::string found = claim.quantity + ": " + claim.where + " alone has it";
    for (const Reading& calibration : calibrations) {
      std::string here;
      bool is_there = false;
      for (const Claim& stated : calibration.claims) {
        is_there = is_there || stated.quantity == claim.quantity;
        if (here.empty()) here = disagreement(claim, stated);
      }
      if (is_there) found = here;
      if (found.empty()) break;
    }
    if (!found.empty()) all.push_back(std::move(found));
  }
  return all;
}

}  // namespace abcal::test
