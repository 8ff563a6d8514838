#include "app/laboratory/certificate/measurand.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "app/laboratory/certificate/dcc_quantity.h"
#include "app/laboratory/certificate/dcc_text.h"
#include "app/laboratory/certificate/dsi_list.h"
#include "app/laboratory/certificate/page_numbers.h"
#include "app/results/export/constants.h"
#include "app/results/report/mounting_figure.h"
#include "protocol/plan/limits.h"

namespace abcal {
namespace {

constexpr const char* kMountingRefType = "abc_mounting";

std::string label_of(std::size_t row, std::size_t column) {
  return fmt::format("M_{}{}", kPlatterAxes.at(row), kOutputNames.at(column));
}

/// "maker, model", in the words of the certificate.
std::string names_of(const Words& words, const ItemIdentityParts& parts, KnownBy known_by) {
  std::string text;
  for (std::size_t i = 0; i < parts.size(); ++i)
    if (parts[i].known_by() == known_by) text += (text.empty() ? "" : ", ") + words(kIdentityWords[i]).text;
  return text;
}

/// As the XML names a part of the identity that nobody read.
std::string stated_part(const Words& words, const std::string& part) {
  return words("{part}: stated, not read", part).text;
}

}  // namespace

std::string identity_value(const PageSource& from, Term part, const std::string& value) {
  const std::vector<std::string> stated = from.xml.texts(
      "dcc:administrativeData/dcc:statements/dcc:statement[@refType='abc_itemIdentity']/dcc:reference");
  if (value.empty() || std::ranges::find(stated, stated_part(from.words, from.say(part))) == stated.end())
    return value;
  return from.words("{value} (stated, not read)", value).text;
}

std::string correction_unit(const std::string& response_unit) {
  const bool is_quotient = response_unit.find('/') != std::string::npos;
  return is_quotient ? fmt::format("(m/s2)/({})", response_unit) : fmt::format("(m/s2)/{}", response_unit);
}

std::optional<CustomerEquation> customer_equation(const StatedResult& stated) {
  const CalibrationResult& result = stated.result;
  CorrectionMatrix correction;
  try {
    correction = correction_matrix(result.sensitivity_values(), result.g_loc.value);
  } catch (const std::invalid_argument&) {
    return std::nullopt;
  }
  CustomerEquation equation;
  Eigen::Matrix<double, 12, 13> derivatives = Eigen::Matrix<double, 12, 13>::Zero();
  derivatives.topLeftCorner<9, 9>() = correction.derivatives.leftCols<9>();
  derivatives.topRightCorner<9, 1>() = correction.derivatives.col(9);
  derivatives.block<3, 3>(9, 9).setIdentity();
  // M is a function of S / g_loc, so that its derivative by S at constant g_loc is g_loc times smaller.
  Eigen::Matrix<double, 12, 12> by_outputs = derivatives.leftCols<12>();
  by_outputs.leftCols<9>() *= result.g_loc.value;
  equation.covariance =
      by_outputs * covariance_of_outputs(stated, *result.covariance) * by_outputs.transpose();
  if (!correction.M.allFinite() || !equation.covariance.allFinite()) return std::nullopt;

  for (Eigen::Index i = 0; i < 9; ++i) {
    const auto row = static_cast<std::size_t>(i / 3), column = static_cast<std::size_t>(i % 3);
    equation.M.push_back(derived_quantity(result, stated.from(), label_of(row, column),
                                          correction_unit(result.response_unit),
                                          {correction.M(i / 3, i % 3), derivatives.row(i).transpose()}));
    Quantity& value = equation.M.back().value;
    value.standard_uncertainty = std::sqrt(std::max(0.0, equation.covariance(i, i)));
  }
  return equation;
}

Statement measurand_statement(const Words& words) {
  Statement statement;
  statement.ref_type = "abc_measurand";
  statement.title = words("Measurand");
  statement.text = words(
      "The sensitivity matrix S and the offsets O are the line response of the item: the straight line r = S "
      "a + O that fits its outputs r best, by least squares, over all directions of an acceleration a of the "
      "size of local gravity, in the middle of the item's temperatures among the conditions, or of those of "
      "the room where its own were not read; these are as they were read. S is not the slope at "
      "zero acceleration: a cubic term k3 of the output, relative to the sensitivity at local gravity, makes "
      "S larger than this slope by 3/5 k3, and a quadratic term k2 makes O larger than the output at zero "
      "acceleration by 1/3 k2 of the sensitivity.");
  return statement;
}

Statement identity_statement(const Words& words, const ReportData& data) {
  Statement statement;
  statement.ref_type = "abc_itemIdentity";
  statement.title = words("Identity");
  statement.text.language = words.language();
  const ItemIdentityParts parts = identity_of(data);
  if (const std::string read = names_of(words, parts, KnownBy::kRead); !read.empty())
    statement.text.text = words("Read from the instrument: {facts}.", read).text;
  if (const std::string stated = names_of(words, parts, KnownBy::kStated); !stated.empty())
    statement.text.text +=
        (statement.text.text.empty() ? "" : " ") +
        words("Stated by the laboratory, not read from an instrument: {facts}.", stated).text;
  // For readers that show a part of the identity alone.
  for (std::size_t i = 0; i < parts.size(); ++i)
    if (parts[i].known_by() == KnownBy::kStated)
      statement.references.push_back(stated_part(words, words(kIdentityWords[i]).text));
  return statement;
}

std::vector<std::string> equation_labels() {
  std::vector<std::string> labels;
  for (std::size_t i = 0; i < 9; ++i) labels.push_back(label_of(i / 3, i % 3));
  for (const char* output : kOutputNames) labels.push_back(fmt::format("b_{}", output));
  return labels;
}

void add_customer_equation(XmlElement& results, const Words& words, const CustomerEquation& equation) {
  XmlElement data =
      add_result(results, "abc_customerEquation", words("Equation for use"),
                 words("a = M (r − b): a is the acceleration (specific force) along x, y, z of the platter, "
                       "r are the three outputs, b are the offsets O, and M is the inverse of S. M contains "
                       "the orientation of the item on the platter. For an item that is mounted in another "
                       "way, use the intrinsic sensitivities, angles and offsets."));
  XmlElement list = data.add("dcc:list");
  list.attribute("refType", "abc_matrix3x3");
  for (std::size_t row = 0; row < 3; ++row) {
    std::vector<std::string> labels;
    std::vector<Quantity> values;
    for (std::size_t column = 0; column < 3; ++column) {
      labels.push_back(label_of(row, column));
      values.push_back(equation.M[3 * row + column].value);
    }
    const auto first = static_cast<Eigen::Index>(3 * row);
    add_list(list, words, words("row of axis {axis}", kPlatterAxes.at(row)),
             list_of(labels, values, equation.covariance.block(first, first, 3, 3)));
  }
}

void add_item_quantities(XmlElement& item, const Words& words, const ReportData& data) {
  XmlElement quantities;
  const auto add = [&](const char* ref_type, const Wording& name, const std::string& value) {
    const std::string text = one_line(value);
    if (text.empty()) return;
    if (quantities.node() == nullptr) quantities = item.add("dcc:itemQuantities");
    XmlElement quantity = quantities.add("dcc:itemQuantity");
    quantity.attribute("refType", ref_type);
    add_words(quantity, "dcc:name", name);
    quantity.add("dcc:noQuantity").add("dcc:content", text);
  };
  for (const ItemFact& fact : kItemSettings) add("abc_setting", words(fact.words), data.label(fact.label));
  add("abc_axes", words("u, v, w along"), data.record.expected.mounting);
  for (const ItemFact& fact : kItemMounting) {
    std::string text = data.label(fact.label);
    // A number with its unit, as the run has it: "0.3 N m".
    if (const std::size_t end = text.find(' '); fact.label == "item.torque" && end != std::string::npos)
      text = typeset_number(text.substr(0, end), words) + text.substr(end);
    add(kMountingRefType, words(fact.words), text);
  }
}

Section equation_section(const PageSource& from, xmlNode* measurement) {
  Section section{from.say("Equation for use"), {}};
  const auto results = from.xml.nodes("dcc:results/dcc:result[@refType='abc_customerEquation']", measurement);
  if (results.empty()) return section;
  section.blocks.push_back(Paragraph{from.content("dcc:description", results.front())});
  DocumentTable table;
  table.dense = true;
  table.columns = {{"", CellKind::kSymbol}};
  for (const char* output : kOutputNames) {
    table.columns.push_back({fmt::format("M_i{}", output), CellKind::kNumber});
    table.columns.push_back({"U", CellKind::kNumber});
  }
  table.columns.push_back({from.say("Unit"), CellKind::kUnit});
  std::size_t row = 0;
  for (xmlNode* quantity : quantities_of(from, results.front())) {
    std::vector<std::string> cells{fmt::format("i = {}", kPlatterAxes.at(row++))};
    std::string unit;
    for (const PageValue& value : values_of(from, quantity, is_hybrid(from, quantity))) {
      cells.push_back(value.value);
      cells.push_back(value.expanded);
      unit = value.unit;
    }
    cells.push_back(unit);
    table.rows.push_back(std::move(cells));
  }
  section.blocks.emplace_back(std::move(table));
  return section;
}

Section mounting_section(const PageSource& from) {
  const std::string quantities =
      "dcc:administrativeData/dcc:items/dcc:item/dcc:itemQuantities/dcc:itemQuantity";
  Section section{from.say("Mounting"), {}};
  FactList list;
  std::string axes;
  MountingWords words{
      from.say(
          "Stated mounting: u, v, w of the item, and x, y, z of the platter at the default orientation."),
      from.say("platter"), from.say("up")};
  for (const char* ref_type : {"abc_axes", kMountingRefType}) {
    for (xmlNode* quantity : from.xml.nodes(fmt::format("{}[@refType='{}']", quantities, ref_type))) {
      list.facts.emplace_back(from.content("dcc:name", quantity), from.content("dcc:noQuantity", quantity));
      const auto& [name, text] = list.facts.back();
      if (axes.empty()) axes = text;
      if (name == from.say("Reference surface")) words.surface = name + ": " + text;
      if (name == from.say("Direction marks")) words.marks = name + ": " + text;
    }
  }
  if (list.facts.empty()) return section;
  section.blocks.emplace_back(std::move(list));
  if (const auto directions = mounting_matrix(axes))
    section.blocks.emplace_back(mounting_figure(*directions, words));
  return section;
}

}  // namespace abcal
