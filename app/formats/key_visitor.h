#pragma once

#include <fmt/format.h>

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/angle.h"

namespace abcal {

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Permitted range of a number. NaN is outside every range.
struct Range {
  double min = -kInfinity;
  double max = kInfinity;
  bool min_excluded = false;

  bool contains(double value) const { return (min_excluded ? value > min : value >= min) && value <= max; }
  std::string words() const {
    if (min == -kInfinity && max == kInfinity) return "a finite number";
    if (max == kInfinity) return fmt::format("a number {} {:g}", min_excluded ? ">" : ">=", min);
    return fmt::format("a number from {}{:g} to {:g}", min_excluded ? "above " : "", min, max);
  }
};

inline constexpr Range kAny{};
inline constexpr Range kPositive{0.0, kInfinity, true};
inline constexpr Range kNotNegative{0.0, kInfinity};

/// Source of a default in a written file, so that reading does not take it for a stated value.
inline constexpr std::string_view kDefaultSource = "default";

/// The word in place of a number that the program determines itself.
inline constexpr std::string_view kAuto = "auto";

/// A standard uncertainty, its source (none: a default), and the name of its distribution (none: normal).
struct StatedUncertainty {
  double value = 0.0;
  std::string source;
  std::string distribution = {};
};

/// A value with its uncertainty and source, as a record of the laboratory gives them.
struct CalibratedNumber {
  double value = 0.0;
  double expanded_uncertainty = 0.0;
  double coverage_factor = 2.0;
  std::string source;
};

/// Visitor of the keys of a file. Each key is named once; reading, writing and the list of known keys all
/// follow from it.
class KeyVisitor {
 public:
  virtual ~KeyVisitor() = default;
  virtual void section(const std::string& path) = 0;
  virtual void text(const std::string& key, std::string& value,
                    const std::vector<std::string>& choices = {}) = 0;
  virtual void required_text(const std::string& key, std::string& value,
                             const std::vector<std::string>& choices = {}) = 0;
  virtual void number(const std::string& key, double& value, Range range) = 0;
  virtual void number(const std::string& key, std::optional<double>& value, Range range) = 0;
  /// A number, or the word "auto".
  virtual void number_or_auto(const std::string& key, double& value, bool& automatic, Range range) = 0;
  virtual void integer(const std::string& key, int& value, int min, int max) = 0;
  virtual void integer(const std::string& key, std::optional<int>& value, int min, int max) = 0;
  virtual void seed(const std::string& key, std::uint64_t& value) = 0;
  virtual void boolean(const std::string& key, bool& value) = 0;
  /// Three numbers, each in the range.
  virtual void vector(const std::string& key, Eigen::Vector3d& value, Range range) = 0;
  /// A standard uncertainty from 0 to `most`: a number, or a table with its source (docs/effects.md). `unit`
  /// is for messages. For a visitor that does not distinguish them it is a number.
  virtual void uncertainty(const std::string& key, StatedUncertainty& stated, double most,
                           const std::string&) {
    number(key, stated.value, {0.0, most});
  }
  /// A number, or the record of the laboratory that has it in this unit; the record then also gives the
  /// uncertainty, coverage factor and source.
  virtual void calibrated(const std::string& key, CalibratedNumber& number_of_key, Range range,
                          const std::string&) {
    number(key, number_of_key.value, range);
  }
  /// Whether keys that are only read, as files of an older schema have them, are to be left out.
  virtual bool writes() const { return false; }
  virtual void integers(const std::string& key, std::array<int, 3>& value, int min, int max) = 0;
  /// Three rows of three numbers, each in the range.
  virtual void matrix(const std::string& key, Eigen::Matrix3d& value, Range range) = 0;
  /// Any number of numbers, each in the range.
  virtual void numbers(const std::string& key, std::vector<double>& value, Range range) = 0;
  /// A table below the current section or entry: visits its keys.
  virtual void table(const std::string& key, const std::function<void()>& visit_keys) = 0;
  /// Whether the file that is read has a list at the top under this name, not a table.
  virtual bool is_list(const std::string&) const { return false; }
  /// Whether a file that is read gives a value under a path from its top ("item[0].simulation.k2").
  virtual bool gives(const std::string&) const { return true; }
  /// Whether every form is to be visited where a file has one of several.
  virtual bool shows_every_form() const { return false; }
  /// An array of tables below the current section: visits each entry; new ones (index >= size) are from the
  /// file.
  virtual void tables(const std::string& key, std::size_t size,
                      const std::function<void(std::size_t)>& visit_entry) = 0;

  template <class T, class Visit>
  void list(const std::string& key, std::vector<T>& value, const T& fresh, Visit visit_entry) {
    tables(key, value.size(), [&](std::size_t i) {
      if (i >= value.size()) value.push_back(fresh);
      visit_entry(*this, value[i]);
    });
  }

  void vector(const std::string& key, std::array<double, 3>& value, Range range) {
    Eigen::Vector3d numbers(value.data());
    vector(key, numbers, range);
    value = {numbers[0], numbers[1], numbers[2]};
  }

  void angle(const std::string& key, Angle& value, Range range) {
    double degrees = value.deg();
    number(key, degrees, range);
    value = Angle::degrees(degrees);
  }
  void angle(const std::string& key, std::optional<Angle>& value, Range range) {
    std::optional<double> degrees = value ? std::optional(value->deg()) : std::nullopt;
    number(key, degrees, range);
    value = degrees ? std::optional(Angle::degrees(*degrees)) : std::nullopt;
  }
};

}  // namespace abcal
