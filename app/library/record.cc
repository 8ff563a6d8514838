#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <sstream>
#include <stdexcept>
#include <utility>

#include "app/library/data.h"
#include "app/results/analysis/estimators.h"
#include "app/results/analysis/load_record.h"
#include "protocol/record/import_table.h"
#include "protocol/record/imported_dwells.h"

namespace abcal::v1 {
namespace {

std::vector<Eigen::Vector3d> vectors_of(const Rows& rows) {
  std::vector<Eigen::Vector3d> vectors(static_cast<std::size_t>(rows.rows()));
  for (std::size_t i = 0; i < vectors.size(); ++i) vectors[i] = rows.row(static_cast<Eigen::Index>(i));
  return vectors;
}

std::vector<double> numbers_of(const Column& column) {
  std::vector<double> numbers(static_cast<std::size_t>(column.size()));
  for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = column[static_cast<Eigen::Index>(i)];
  return numbers;
}

::abcal::TableOptions options_of(const TableSettings& settings) {
  return {.columns = settings.columns,
          .unit = settings.unit,
          .time_unit = settings.time_unit,
          .topic = settings.topic};
}

void set_gravity(const RecordSettings& settings, ::abcal::RunRecord& record) {
  if (settings.g_loc_mps2 == 0.0) return;
  constexpr double kLeast = 9.0, kMost = 10.5;
  if (!(settings.g_loc_mps2 >= kLeast && settings.g_loc_mps2 <= kMost))
    throw std::invalid_argument(
        fmt::format("{}: g_loc: found {:g} m/s2; required: {:g} to {:g} m/s2, or none", settings.source,
                    settings.g_loc_mps2, kLeast, kMost));
  if (!(settings.g_loc_u_mps2 >= 0.0 && settings.g_loc_u_mps2 < 1.0))
    throw std::invalid_argument(
        fmt::format("{}: standard uncertainty of g_loc: found {:g} m/s2; required: 0 to 1 m/s2",
                    settings.source, settings.g_loc_u_mps2));
  record.g_loc_known = true;
  record.g_loc.value_mps2 = settings.g_loc_mps2;
  record.g_loc.expanded_uncertainty_mps2 = settings.g_loc_u_mps2 * record.g_loc.coverage_factor;
  record.g_loc.source = settings.g_loc_source;
}

::abcal::RunRecord record_of(const RecordArrays& arrays, std::span<const int> face,
                             const RecordSettings& settings) {
  ::abcal::RecordRows rows;
  rows.experiment.assign(arrays.experiment.begin(), arrays.experiment.end());
  rows.alpha_deg = numbers_of(arrays.alpha_deg);
  rows.mean = vectors_of(arrays.readings);
  rows.u_mean = vectors_of(arrays.u);
  rows.time_s = numbers_of(arrays.time_s);
  rows.face.assign(face.begin(), face.end());
  ::abcal::RunRecord record = ::abcal::record_of_rows(rows, settings.source);
  if (!settings.response_unit.empty()) record.response_unit = settings.response_unit;
  if (!settings.estimator.empty()) record.estimator = ::abcal::find_estimator(settings.estimator).name;
  set_gravity(settings, record);
  set_effects(settings.effects, record.tolerances);
  return record;
}

}  // namespace

void set_effects(const std::map<std::string, double>& effects, ::abcal::EffectSizes& sizes) {
  for (const auto& [key, value] : effects) {
    const ::abcal::EffectSizeKey* found = nullptr;
    std::vector<std::string_view> known;
    for (const ::abcal::EffectSizeKey& each : ::abcal::effect_size_keys()) {
      known.push_back(each.key);
      if (each.key == key) found = &each;
    }
    if (found == nullptr)
      throw std::invalid_argument(
          fmt::format("effects: found \"{}\"; required: {}", key, fmt::join(known, ", ")));
    if (!(value >= 0.0 && value <= found->most))
      throw std::invalid_argument(fmt::format("effects, {}: found {:g}; required: 0 to {:g}{}", key, value,
                                              found->most,
                                              found->unit == "1" ? "" : " " + std::string(found->unit)));
    found->set(sizes, value);
    sizes.sources[key] = "stated";
  }
}

Record::Record(const RecordArrays& arrays, const RecordSettings& settings)
    : Record(arrays, std::span<const int>(), settings) {}

Record::Record(const RecordArrays& arrays, std::span<const int> face, const RecordSettings& settings)
    : data_(std::make_shared<const Data>(Data{record_of(arrays, face, settings)})) {}

std::string Record::source() const {
  return data_->record.source;
}
std::string Record::response_unit() const {
  return data_->record.response_unit;
}
std::string Record::estimator() const {
  return data_->record.estimator;
}
std::size_t Record::size() const {
  return data_->record.dwells.size();
}

std::size_t Record::flagged() const {
  std::size_t count = 0;
  for (const ::abcal::DwellRecord& dwell : data_->record.dwells) count += dwell.flags != 0 ? 1U : 0U;
  return count;
}

double Record::g_loc_mps2() const {
  return data_->record.g_loc_known ? data_->record.g_loc.value_mps2 : kNan;
}

std::vector<int> Record::experiment() const {
  std::vector<int> list;
  for (const ::abcal::DwellRecord& dwell : data_->record.dwells) list.push_back(dwell.experiment);
  return list;
}

std::vector<int> Record::face() const {
  std::vector<int> list;
  for (const ::abcal::DwellRecord& dwell : data_->record.dwells) list.push_back(dwell.face);
  return list;
}

namespace {

// The dwells of a record are contiguous, so that one member of all dwells is a column with a stride.
static_assert(sizeof(::abcal::DwellRecord) % sizeof(double) == 0);
static_assert(sizeof(::abcal::Angle) == sizeof(double));
constexpr Eigen::Index kStride = sizeof(::abcal::DwellRecord) / sizeof(double);

}  // namespace

Column Record::alpha_deg() const {
  const std::vector<::abcal::DwellRecord>& dwells = data_->record.dwells;
  if (dwells.empty()) return no_column();
  return {reinterpret_cast<const double*>(&dwells.front().alpha), static_cast<Eigen::Index>(dwells.size()),
          Eigen::InnerStride<Eigen::Dynamic>(kStride)};
}

Rows Record::readings() const {
  const std::vector<::abcal::DwellRecord>& dwells = data_->record.dwells;
  if (dwells.empty()) return no_rows();
  return {dwells.front().mean.data(), static_cast<Eigen::Index>(dwells.size()), 3, {kStride, 1}};
}

std::vector<double> Record::time_s() const {
  std::vector<double> list;
  for (const ::abcal::DwellRecord& dwell : data_->record.dwells) list.push_back(dwell.time_s.value_or(kNan));
  return list;
}

Eigen::Matrix<double, Eigen::Dynamic, 3> Record::u() const {
  const std::vector<::abcal::DwellRecord>& dwells = data_->record.dwells;
  Eigen::Matrix<double, Eigen::Dynamic, 3> rows(static_cast<Eigen::Index>(dwells.size()), 3);
  for (std::size_t i = 0; i < dwells.size(); ++i)
    rows.row(static_cast<Eigen::Index>(i)) =
        dwells[i].u_mean.value_or(Eigen::Vector3d::Constant(kNan)).transpose();
  return rows;
}

std::vector<bool> Record::closing() const {
  std::vector<bool> list;
  for (const ::abcal::DwellRecord& dwell : data_->record.dwells) list.push_back(dwell.closing);
  return list;
}

std::map<std::string, double> Record::effects() const {
  std::map<std::string, double> sizes;
  for (const ::abcal::EffectSizeKey& each : ::abcal::effect_size_keys())
    sizes[std::string(each.key)] = each.get(data_->record.tolerances);
  return sizes;
}

std::vector<std::string> Record::default_effects() const {
  std::vector<std::string> words;
  for (const ::abcal::Term& effect : ::abcal::unstated_effects(data_->record.tolerances))
    words.emplace_back(effect);
  return words;
}

Record load(const std::filesystem::path& path) {
  return Record(std::make_shared<const Record::Data>(Record::Data{::abcal::load_record(path).record}));
}

Record load_poses(const std::filesystem::path& path) {
  return load(path);
}

Record load_table(const std::filesystem::path& path, const TableSettings& settings) {
  return Record(std::make_shared<const Record::Data>(
      Record::Data{::abcal::load_record(path, 0, options_of(settings)).record}));
}

Record read_table(const std::string& text, const std::string& source, const TableSettings& settings) {
  std::istringstream in(text);
  return Record(std::make_shared<const Record::Data>(
      Record::Data{::abcal::import_table(in, source, options_of(settings)).record}));
}

}  // namespace abcal::v1
