#include "abcal/certificate.h"

#include <limits>

#include "app/laboratory/certificate/report_certificate.h"
#include "app/laboratory/compare/read_certificate.h"
#include "app/library/helper_folder.h"
#include "app/results/analysis/report_data.h"
#include "app/system/real_clock.h"

namespace abcal::v1 {

struct [[gnu::visibility("hidden")]] Certificate::Data {
  ::abcal::ComparedResult read;
  Covariance intrinsic;
};

Certificate::Certificate(const std::filesystem::path& path) {
  Data data;
  data.read = ::abcal::read_certificate(path);
  data.intrinsic.values = data.read.values;
  data.intrinsic.matrix = data.read.covariance;
  const std::array<std::string, 9> units = ::abcal::units_of_properties(data.read);
  data.intrinsic.units.assign(units.begin(), units.end());
  data.intrinsic.labels.assign(::abcal::kIntrinsicSymbols.begin(), ::abcal::kIntrinsicSymbols.end());
  data_ = std::make_shared<const Data>(std::move(data));
}

std::string Certificate::number() const {
  return data_->read.what;
}
std::string Certificate::date() const {
  return data_->read.date;
}
std::string Certificate::item() const {
  return data_->read.item;
}
std::string Certificate::serial_number() const {
  return data_->read.item_serial_number;
}
std::string Certificate::response_unit() const {
  return data_->read.unit_name;
}
double Certificate::g_loc_mps2() const {
  return data_->read.g_loc ? data_->read.g_loc->value : std::numeric_limits<double>::quiet_NaN();
}
std::optional<Eigen::Matrix3d> Certificate::sensitivity_matrix() const {
  return data_->read.matrix;
}
const Covariance& Certificate::intrinsic() const {
  return data_->intrinsic;
}
bool Certificate::with_correlations() const {
  return data_->read.with_correlations;
}
std::vector<std::string> Certificate::notes() const {
  return data_->read.notes;
}

std::string certificate_xml(const std::filesystem::path& run, const CertificateChoices& choices) {
  find_helpers();
  ::abcal::CertificateFiles files;
  files.laboratory = choices.laboratory.string();
  files.as_found = choices.as_found.string();
  files.schemas = choices.schemas.string();
  files.language = choices.language;
  const ::abcal::Clock::UtcTime now = ::abcal::RealClock().utc_now();
  return ::abcal::certificate_for_report(::abcal::gather_report(run, now), files, true, now);
}

}  // namespace abcal::v1
