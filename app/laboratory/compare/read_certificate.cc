#include "app/laboratory/compare/read_certificate.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <charconv>
#include <cmath>
#include <stdexcept>

#include "app/formats/dsi_unit.h"
#include "app/formats/xml_query.h"
#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/dcc_state.h"
#include "app/system/read_file.h"
#include "protocol/estimators/circle/sensitivity_matrix.h"
#include "protocol/estimators/shared/intrinsic_properties.h"

namespace abcal {
namespace {

constexpr std::size_t kMostProblems = 20;  // A longer list would not be read.
constexpr std::size_t kMostLabels = 1000;  // Labels of one list: its covariances are that number squared.
constexpr std::ptrdiff_t kLabelsShown = 12;
constexpr double kRadToDeg = 180.0 / 3.14159265358979323846;

/// A number of the certificate with its standard uncertainty, in base units.
struct Number {
  double value = 0.0;
  double standard_uncertainty = std::nan("");
  UnitMeaning unit;
};

/// Covariances of a list of labels, in base units.
struct CovarianceList {
  std::vector<std::string> labels;
  Eigen::MatrixXd matrix;
};

struct Numbers {
  std::map<std::string, Number> by_label;
  std::vector<CovarianceList> covariances;
  bool from_state = false;  ///< The twelve outputs with all digits, of which the other ones are functions.
};

/// Labels of the twelve outputs.
const std::array<std::string, 12> kOutputLabels = [] {
  std::array<std::string, 12> labels;
  std::copy_n(kOutputSymbols.begin(), labels.size(), labels.begin());
  return labels;
}();

bool is_of_accelerometer(const std::string& label) {
  return std::find(kOutputLabels.begin(), kOutputLabels.end(), label) != kOutputLabels.end() ||
         std::find(kIntrinsicSymbols.begin(), kIntrinsicSymbols.end(), label) != kIntrinsicSymbols.end();
}

/// Reads lists of numbers and keeps every problem.
class ListReader {
 public:
  ListReader(const XmlQuery& certificate, std::vector<std::string>& problems)
      : certificate_(certificate), problems_(problems) {}

  void read(xmlNode* list, Numbers& numbers) {
    const std::vector<std::string> labels = certificate_.words("si:labelXMLList", list);
    const bool wanted = std::any_of(labels.begin(), labels.end(), is_of_accelerometer);
    if (!wanted) return;
    const std::size_t size = labels.size();
    where_ = fmt::format(
        "list \"{}\"",
        fmt::join(labels.begin(), labels.begin() + std::min(std::ssize(labels), kLabelsShown), " "));
    if (size > kMostLabels) return problem(fmt::format("{} labels; required: at most {}", size, kMostLabels));
    const std::vector<double> values = real_list("si:valueXMLList", list, size);
    const std::vector<UnitMeaning> units = unit_list("si:unitXMLList", list, size);
    const std::vector<double> u = uncertainties(list, size);
    if (values.size() != size || units.size() != size) return;
    for (std::size_t i = 0; i < size; ++i) {
      if (!is_of_accelerometer(labels[i])) continue;
      Number number{values[i] * units[i].factor, u.size() == size ? u[i] * units[i].factor : std::nan(""),
                    units[i]};
      number.unit.factor = 1.0;
      // A quantity may be in more than one list; the first with an uncertainty counts.
      const auto [place, is_new] = numbers.by_label.emplace(labels[i], number);
      if (!is_new && std::isnan(place->second.standard_uncertainty)) place->second = number;
    }
    read_covariance(list, labels, numbers);
  }

  /// The state of a certificate of ours: the twelve outputs with all digits and their covariance as it was
  /// measured, not as it was raised to a scope. It takes the place of all that was read before.
  void read_state(xmlNode* measurement, Numbers& numbers) {
    where_ = kStateType;
    const auto found =
        certificate_.nodes(fmt::format("dcc:results/dcc:result[@refType='{}']", kStateType), measurement);
    if (found.empty()) return;
    Numbers state;
    state.from_state = true;
    for (xmlNode* list : certificate_.nodes(
             fmt::format("dcc:data/dcc:quantity[@refType='{}']/si:realListXMLList", kStateValues),
             found.front()))
      read(list, state);
    CovarianceList& covariance = state.covariances.emplace_back();
    covariance.labels.assign(kOutputLabels.begin(), kOutputLabels.end());
    for (const char* type : {kMeasuredCovariance, kStateCovariance}) {
      covariance.matrix = covariance_rows(type, found.front());
      if (covariance.matrix.allFinite()) break;
    }
    if (state.by_label.size() != kOutputLabels.size() || !covariance.matrix.allFinite() ||
        !(covariance.matrix.diagonal().array() > 0.0).all())
      return problem("twelve outputs with a covariance required");
    for (std::size_t i = 0; i < kOutputLabels.size(); ++i) {
      const auto at = static_cast<Eigen::Index>(i);
      state.by_label.at(kOutputLabels[i]).standard_uncertainty = std::sqrt(covariance.matrix(at, at));
    }
    numbers = std::move(state);
  }

 private:
  /// A covariance of the outputs that is given row by row; elements that are not there are NaN.
  Eigen::MatrixXd covariance_rows(const char* type, xmlNode* state) {
    Eigen::MatrixXd matrix = Eigen::MatrixXd::Constant(12, 12, std::nan(""));
    const auto place = [](const std::string& label) {
      return std::find(kOutputLabels.begin(), kOutputLabels.end(), label) - kOutputLabels.begin();
    };
    for (xmlNode* row :
         certificate_.nodes(fmt::format("dcc:data/dcc:list[@refType='{}']/dcc:quantity", type), state)) {
      const Eigen::Index i = place(certificate_.text("dcc:name/dcc:content", row));
      const std::vector<std::string> labels = certificate_.words("si:realListXMLList/si:labelXMLList", row);
      const std::vector<double> values = real_list("si:realListXMLList/si:valueXMLList", row, labels.size());
      const std::vector<UnitMeaning> units =
          unit_list("si:realListXMLList/si:unitXMLList", row, labels.size());
      if (i == matrix.rows() || values.size() != labels.size() || units.size() != labels.size()) continue;
      for (std::size_t n = 0; n < labels.size(); ++n)
        if (const Eigen::Index j = place(labels[n]); j < matrix.cols())
          matrix(i, j) = values[n] * units[n].factor;
    }
    return matrix;
  }

  void problem(const std::string& what) {
    if (problems_.size() < kMostProblems) problems_.push_back(where_ + ": " + what);
  }

  /// The requested number of entries: in D-SI one entry may stand for all. Empty, with a problem, otherwise.
  template <class T>
  std::vector<T> spread_over(std::vector<T> list, std::size_t size, const std::string& what) {
    if (list.size() == 1) list.resize(size, list.front());
    if (list.size() == size) return list;
    problem(fmt::format("{} has {} entries; required: 1 or {}", what, list.size(), size));
    return {};
  }

  std::vector<double> real_list(const char* path, xmlNode* from, std::size_t size) {
    std::vector<double> values;
    for (const std::string& word : certificate_.words(path, from)) {
      double value = 0.0;
      const char* begin = word.data() + (word.starts_with('+') ? 1 : 0);  // from_chars takes no plus
      const auto [stop, error] = std::from_chars(begin, word.data() + word.size(), value);
      if (error != std::errc() || stop != word.data() + word.size() || !std::isfinite(value)) {
        problem(fmt::format("{}: \"{}\" is not a number; required: a finite one", path, word));
        return {};
      }
      values.push_back(value);
    }
    return spread_over(std::move(values), size, path);
  }

  std::vector<UnitMeaning> unit_list(const char* path, xmlNode* from, std::size_t size) {
    std::vector<UnitMeaning> units;
    for (const std::string& word : certificate_.words(path, from)) {
      try {
        units.push_back(meaning_of_d_si(word));
      } catch (const std::invalid_argument& error) {
        problem(error.what());
        return {};
      }
    }
    return spread_over(std::move(units), size, path);
  }

  /// Standard uncertainties, whichever way they are given; empty if they are not.
  std::vector<double> uncertainties(xmlNode* list, std::size_t size) {
    constexpr const char* kExpanded = "si:measurementUncertaintyUnivariateXMLList/si:expandedMUXMLList";
    for (xmlNode* expanded : certificate_.nodes(kExpanded, list)) {
      std::vector<double> u = real_list("si:valueExpandedMUXMLList", expanded, size);
      const std::vector<double> k = real_list("si:coverageFactorXMLList", expanded, size);
      if (u.size() != size || k.size() != size) return {};
      for (std::size_t i = 0; i < size; ++i) {
        if (!(u[i] > 0.0) || !(k[i] > 0.0)) {
          problem(fmt::format("U = {} with k = {}; required: both greater than 0", u[i], k[i]));
          return {};
        }
        u[i] /= k[i];
      }
      return u;
    }
    constexpr const char* kStandard =
        "si:measurementUncertaintyUnivariateXMLList/*/si:valueStandardMUXMLList";
    if (certificate_.nodes(kStandard, list).empty()) return {};
    std::vector<double> u = real_list(kStandard, list, size);
    for (const double each : u) {
      if (each > 0.0) continue;
      problem(fmt::format("standard uncertainty {}; required: greater than 0", each));
      return {};
    }
    return u;
  }

  void read_covariance(xmlNode* list, const std::vector<std::string>& labels, Numbers& numbers) {
    const std::vector<xmlNode*> columns = certificate_.nodes(
        "si:measurementUncertaintyMultivariateXMLList//si:covarianceMatrixXMLList/si:columnXMLList", list);
    if (columns.empty()) return;
    const std::size_t size = labels.size();
    if (columns.size() != size) {
      problem(fmt::format("its covariance matrix has {} columns; required: {}", columns.size(), size));
      return;
    }
    const auto n = static_cast<Eigen::Index>(size);
    CovarianceList covariance{labels, Eigen::MatrixXd(n, n)};
    for (Eigen::Index j = 0; j < n; ++j) {
      xmlNode* column = columns[static_cast<std::size_t>(j)];
      const std::vector<double> values = real_list("si:covarianceXMLList/si:valueXMLList", column, size);
      const std::vector<UnitMeaning> units = unit_list("si:covarianceXMLList/si:unitXMLList", column, size);
      if (values.size() != size || units.size() != size) return;
      for (Eigen::Index i = 0; i < n; ++i) {
        const auto row = static_cast<std::size_t>(i);
        covariance.matrix(i, j) = values[row] * units[row].factor;
      }
    }
    if (!(covariance.matrix.diagonal().array() > 0.0).all()) {
      problem("its covariance matrix has a variance that is not greater than 0");
      return;
    }
    const double asymmetry = (covariance.matrix - covariance.matrix.transpose()).norm();
    if (!(asymmetry <= 1e-6 * covariance.matrix.norm())) {
      problem("its covariance matrix is not symmetric");
      return;
    }
    numbers.covariances.push_back(std::move(covariance));
  }

  const XmlQuery& certificate_;
  std::vector<std::string>& problems_;
  std::string where_;
};

/// Covariance from coefficients of correlation and the uncertainties of the values: how our certificates up
/// to 1.1 give it for outputs of different units. A list that is not complete is left out.
void read_correlations(const XmlQuery& certificate, xmlNode* measurement, Numbers& numbers) {
  for (xmlNode* list : certificate.nodes(
           "dcc:results//dcc:list[starts-with(@refType, 'abc_correlation')][dcc:quantity]", measurement)) {
    const std::vector<xmlNode*> rows = certificate.nodes("dcc:quantity/si:realListXMLList", list);
    CovarianceList covariance{certificate.words("si:labelXMLList", rows.front()), {}};
    const auto n = static_cast<Eigen::Index>(covariance.labels.size());
    covariance.matrix.setConstant(n, n, std::nan(""));
    for (Eigen::Index i = 0; i < n && rows.size() == covariance.labels.size(); ++i) {
      const std::vector<std::string> words =
          certificate.words("si:valueXMLList", rows[static_cast<std::size_t>(i)]);
      for (Eigen::Index j = 0; j < n && words.size() == covariance.labels.size(); ++j) {
        const auto u = [&](Eigen::Index k) {
          const auto found = numbers.by_label.find(covariance.labels[static_cast<std::size_t>(k)]);
          return found == numbers.by_label.end() ? std::nan("") : found->second.standard_uncertainty;
        };
        const std::string& word = words[static_cast<std::size_t>(j)];
        double correlation = std::nan("");
        std::from_chars(word.data(), word.data() + word.size(), correlation);
        if (std::abs(correlation) <= 1.0) covariance.matrix(i, j) = correlation * u(i) * u(j);
      }
    }
    if (covariance.matrix.allFinite()) numbers.covariances.push_back(std::move(covariance));
  }
}

/// Covariance of these labels from one list that holds all of them; nullopt if no list does.
template <std::size_t N>
std::optional<Eigen::MatrixXd> covariance_of(const Numbers& numbers,
                                             const std::array<std::string, N>& labels) {
  for (const CovarianceList& list : numbers.covariances) {
    std::vector<Eigen::Index> places;
    for (const std::string& label : labels) {
      const auto found = std::find(list.labels.begin(), list.labels.end(), label);
      if (found != list.labels.end()) places.push_back(found - list.labels.begin());
    }
    if (places.size() == N) return list.matrix(places, places);
  }
  return std::nullopt;
}

/// The covariance from lists of parts: elements between two lists stay 0.
template <std::size_t N>
Eigen::MatrixXd pieced_covariance(const Numbers& numbers, const std::array<std::string, N>& labels) {
  const auto n = static_cast<Eigen::Index>(N);
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto found = numbers.by_label.find(labels[static_cast<std::size_t>(i)]);
    const double u = found == numbers.by_label.end() ? std::nan("") : found->second.standard_uncertainty;
    matrix(i, i) = u * u;
  }
  for (const CovarianceList& list : numbers.covariances) {
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = 0; j < n; ++j) {
        const auto row =
            std::find(list.labels.begin(), list.labels.end(), labels[static_cast<std::size_t>(i)]);
        const auto column =
            std::find(list.labels.begin(), list.labels.end(), labels[static_cast<std::size_t>(j)]);
        if (row != list.labels.end() && column != list.labels.end())
          matrix(i, j) = list.matrix(row - list.labels.begin(), column - list.labels.begin());
      }
    }
  }
  return matrix;
}

std::array<std::string, 9> intrinsic_labels() {
  std::array<std::string, 9> labels;
  std::copy(kIntrinsicSymbols.begin(), kIntrinsicSymbols.end(), labels.begin());
  return labels;
}

double value_of(const Numbers& numbers, const std::string& label) {
  const auto found = numbers.by_label.find(label);
  return found == numbers.by_label.end() ? std::nan("") : found->second.value;
}

/// The response unit that sensitivities (R/(m/s2)) and offsets (R) agree on.
void find_response_unit(const Numbers& numbers, ComparedResult& result, std::vector<std::string>& problems) {
  std::optional<UnitMeaning> response;
  for (const auto& [label, number] : numbers.by_label) {
    if (label.starts_with("phi_")) {
      if (number.unit.powers != std::map<std::string, int>{{"radian", 1}})
        problems.push_back(fmt::format("{} is in {}; required: an angle", label, name_of(number.unit)));
      continue;
    }
    const UnitMeaning unit = label.starts_with("s_") ? number.unit * metre_per_second_squared() : number.unit;
    if (!response) response = unit;
    if (!response->same_kind(unit)) {
      problems.push_back(
          fmt::format("{} is in {}, which does not go with the other quantities (a response in {}; "
                      "sensitivities per m/s2)",
                      label, name_of(number.unit), name_of(*response)));
    }
  }
  if (response) result.unit = *response;
  result.unit_name = name_of(result.unit);
}

void fill_values(const Numbers& numbers, ComparedResult& result) {
  Eigen::Matrix<double, 12, 1> outputs;
  for (Eigen::Index i = 0; i < 12; ++i)
    outputs(i) = value_of(numbers, kOutputLabels[static_cast<std::size_t>(i)]);
  const std::optional<Eigen::MatrixXd> full = covariance_of(numbers, kOutputLabels);
  result.output_covariance = full ? *full : pieced_covariance(numbers, kOutputLabels);
  if (outputs.head<9>().allFinite() && result.output_covariance.topLeftCorner<9, 9>().allFinite())
    result.matrix = sensitivity_matrix_of(outputs);

  // Angles are kept in degrees, here as in the program's own results.
  IntrinsicValues to_degrees = IntrinsicValues::Ones();
  to_degrees.segment<3>(3).setConstant(kRadToDeg);
  const std::array<std::string, 9> labels = intrinsic_labels();
  for (Eigen::Index i = 0; i < 9; ++i)
    result.values(i) = value_of(numbers, labels[static_cast<std::size_t>(i)]) * to_degrees(i);
  const std::optional<Eigen::MatrixXd> stated = covariance_of(numbers, labels);
  result.covariance = to_degrees.asDiagonal() * (stated ? *stated : pieced_covariance(numbers, labels)) *
                      to_degrees.asDiagonal();
  result.with_correlations = stated.has_value();
  if (!result.matrix || stated) return;

  // Properties that are not stated follow from the matrix; all correlations do, too, if its own are known.
  const IntrinsicProperties computed = intrinsic_properties(*result.matrix);
  IntrinsicValues from_matrix;
  from_matrix << computed.sensitivity, computed.angle_deg, outputs.tail<3>();
  const Eigen::Matrix<double, 9, 12> jacobian = intrinsic_jacobian(*result.matrix);
  Covariance12 outputs_covariance = result.output_covariance;
  const bool with_offsets = outputs_covariance.allFinite();
  if (!with_offsets) {
    outputs_covariance.rightCols<3>().setZero();
    outputs_covariance.bottomRows<3>().setZero();
  }
  Covariance9 covariance = jacobian * outputs_covariance * jacobian.transpose();
  if (!with_offsets) covariance.diagonal().tail<3>() = result.covariance.diagonal().tail<3>();
  for (Eigen::Index i = 0; i < 9; ++i) {
    if (std::isfinite(result.values(i)) && std::isfinite(result.covariance(i, i)) && !full) {
      // A stated uncertainty is better than one from a matrix without its correlations.
      const double ratio = std::sqrt(result.covariance(i, i) / covariance(i, i));
      if (std::isfinite(ratio)) {
        covariance.row(i) *= ratio;
        covariance.col(i) *= ratio;
      }
    } else if (!std::isfinite(result.values(i))) {
      result.values(i) = from_matrix(i);
      if (!numbers.from_state)
        result.notes.push_back(
            fmt::format("{} was computed from the matrix", kIntrinsicSymbols[static_cast<std::size_t>(i)]));
    }
  }
  result.covariance = covariance;
  result.with_correlations = full.has_value();
}

/// The maker's number of an item or an equipment; empty: none is stated.
std::string serial_number_of(const XmlQuery& certificate, xmlNode* of) {
  const std::string number =
      certificate.text("dcc:identifications/dcc:identification[dcc:issuer='manufacturer']/dcc:value", of);
  return number == "not stated" ? std::string() : number;  // so our certificates up to 1.1 said it
}

void fill_identity(const XmlQuery& certificate, ComparedResult& result) {
  constexpr const char* kItem = "dcc:administrativeData/dcc:items/dcc:item";
  const std::vector<xmlNode*> items = certificate.nodes(kItem);
  if (!items.empty()) {
    result.item_serial_number = serial_number_of(certificate, items.front());
    for (const std::string& word :
         {certificate.text("dcc:manufacturer/dcc:name/dcc:content", items.front()),
          certificate.text("dcc:model", items.front()), result.item_serial_number}) {
      if (!word.empty()) result.item += (result.item.empty() ? "" : " ") + word;
    }
  }
  const std::string core = "dcc:administrativeData/dcc:coreData/";
  result.date = certificate.text(core + "dcc:endPerformanceDate");
  result.what = certificate.text(core + "dcc:uniqueIdentifier");
}

/// The stage as it identified itself to the program that measured. Certificates of other programs do not
/// state which equipment is the stage.
void fill_stage(const XmlQuery& certificate, xmlNode* measurement, ComparedResult& result) {
  constexpr const char* kStage =
      "(dcc:measuringEquipments | ../dcc:measuringEquipments)"
      "/dcc:measuringEquipment[contains(concat(' ', @refType, ' '), ' abc_stage ')]";
  const std::vector<xmlNode*> found = certificate.nodes(kStage, measurement);
  if (found.empty()) return;
  result.stage = certificate.text("dcc:model", found.front());
  result.stage_serial_number = serial_number_of(certificate, found.front());
  if (!result.stage_serial_number.empty())
    result.stage += (result.stage.empty() ? "" : " ") + result.stage_serial_number;
}

void fill_gravity(const XmlQuery& certificate, xmlNode* measurement, ComparedResult& result) {
  constexpr const char* kGravity =
      "(dcc:influenceConditions | ../dcc:influenceConditions)"
      "/dcc:influenceCondition[contains(concat(' ', @refType, ' '), ' abc_localGravity ')]//si:real";
  const std::vector<xmlNode*> found = certificate.nodes(kGravity, measurement);
  if (found.empty()) return;
  Quantity g;
  g.unit = "m/s2";
  const std::string value = certificate.text("si:value", found.front());
  std::from_chars(value.data(), value.data() + value.size(), g.value);
  if (std::isfinite(g.value)) result.g_loc = g;
  result.g_loc_source = "certificate " + result.what;
}

}  // namespace

ComparedResult read_certificate(const std::filesystem::path& path) {
  const XmlDocument document = parse_xml(read_file(path, kLargestXml), path.string());
  const XmlQuery certificate(document.get());
  ComparedResult result;
  result.file = path.string();
  result.kind = "certificate";
  result.per_g_loc = false;
  if (certificate.nodes("/dcc:digitalCalibrationCertificate").empty())
    throw std::runtime_error(path.string() +
                             ": XML, but not a digital calibration certificate (root element of "
                             "https://ptb.de/dcc required)");
  fill_identity(certificate, result);
  // The results over temperature of our certificates are not a calibration of the nine properties.
  const std::vector<xmlNode*> measurements = certificate.nodes(
      "dcc:measurementResults/dcc:measurementResult[.//si:labelXMLList]"
      "[not(@refType = 'abc_temperatureSeries')]");
  std::vector<std::string> problems;
  Numbers numbers;
  if (!measurements.empty()) {
    // As found, then as left: the last is the state of the item on its return.
    xmlNode* measurement = measurements.back();
    if (measurements.size() > 1) {
      result.notes.push_back(fmt::format("the last of its {} results is taken: {}", measurements.size(),
                                         certificate.text("dcc:name/dcc:content", measurement)));
    }
    ListReader reader(certificate, problems);
    const std::string values = fmt::format(
        "dcc:results//si:realListXMLList[not(ancestor::dcc:metaData)]"
        "[not(ancestor::dcc:list[starts-with(@refType, 'abc_correlation') or @refType = 'abc_budgetLine'])]"
        "[not(ancestor::dcc:result[@refType = '{}'])]",
        kStateType);
    for (xmlNode* list : certificate.nodes(values, measurement)) reader.read(list, numbers);
    read_correlations(certificate, measurement, numbers);
    reader.read_state(measurement, numbers);
    fill_gravity(certificate, measurement, result);
    fill_stage(certificate, measurement, result);
    result.estimator = certificate.text(
        "dcc:measurementMetaData/dcc:metaData[@refType='abc_estimator']/dcc:data/dcc:text/dcc:content",
        measurement);
  }
  if (numbers.by_label.empty() && problems.empty()) {
    problems.push_back(
        "no list of numbers is labelled as properties of a triaxial accelerometer (s_ux ... s_wz, s_u, "
        "phi_uv, "
        "O_u)");
  }
  find_response_unit(numbers, result, problems);
  if (!problems.empty()) {
    throw std::runtime_error(
        fmt::format("{}: cannot be read as a certificate of a triaxial accelerometer:\n  {}", path.string(),
                    fmt::join(problems, "\n  ")));
  }
  fill_values(numbers, result);
  if (!result.with_correlations)
    result.notes.push_back(
        "it does not give all covariances of the nine properties: those not given count as 0");
  return result;
}

}  // namespace abcal
