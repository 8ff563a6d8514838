#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "abcal/values.h"

namespace abcal::v1 {
/// A digital calibration certificate (DCC 3) of a triaxial accelerometer, read from a file.
class Certificate {
 public:
  /// Nothing is loaded from the network, and no entity is expanded.
  /// @throws std::runtime_error with every problem of the file
  explicit Certificate(const std::filesystem::path& path);

  std::string number() const;
  std::string date() const;  ///< Date of the measurement, ISO 8601.
  std::string item() const;  ///< Maker, model, serial number.
  std::string serial_number() const;
  std::string response_unit() const;
  double g_loc_mps2() const;  ///< NaN: not given.
  /// R/(m/s2), rows u v w; absent: not given.
  std::optional<Eigen::Matrix3d> sensitivity_matrix() const;
  /// Sensitivities s_u s_v s_w (R/(m/s2)), angles phi_uv phi_vw phi_wu (degree), offsets (R). NaN: not
  /// given.
  const Covariance& intrinsic() const;
  bool with_correlations() const;  ///< False: covariances that are not given count as 0.
  std::vector<std::string> notes() const;

  struct Data;

 private:
  std::shared_ptr<const Data> data_;
};

struct CertificateChoices {
  std::filesystem::path laboratory;     ///< Laboratory file (TOML).
  std::filesystem::path as_found = {};  ///< Run of the item before it was adjusted; empty: none.
  std::filesystem::path schemas = {};   ///< Instead of those that are installed with abcal.
  std::string language = {};            ///< Instead of the laboratory file's.
};

/// XML of a run's certificate: of the one that was issued, byte for byte, or else of a draft, marked as
/// such. A certificate is issued by `abcal issue` only, where the register and the approver are asked.
/// @throws std::runtime_error with every problem of the laboratory file and of the run
std::string certificate_xml(const std::filesystem::path& run, const CertificateChoices& choices);

}  // namespace abcal::v1
