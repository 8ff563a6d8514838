#pragma once

#include <string>
#include <vector>

#include "app/formats/key_visitor.h"

namespace abcal {

/// Writes the keys that it is asked for as TOML. Numbers have the shortest digits that read back as the same
/// number.
class TomlWriter final : public KeyVisitor {
 public:
  void section(const std::string& path) override;
  void text(const std::string& key, std::string& value,
            const std::vector<std::string>& choices = {}) override;
  void required_text(const std::string& key, std::string& value,
                     const std::vector<std::string>& choices = {}) override;
  void number(const std::string& key, double& value, Range range) override;
  void number(const std::string& key, std::optional<double>& value, Range range) override;
  void number_or_auto(const std::string& key, double& value, bool& automatic, Range range) override;
  void integer(const std::string& key, int& value, int min, int max) override;
  void integer(const std::string& key, std::optional<int>& value, int min, int max) override;
  void seed(const std::string& key, std::uint64_t& value) override;
  void boolean(const std::string& key, bool& value) override;
  void vector(const std::string& key, Eigen::Vector3d& value, Range range) override;
  void uncertainty(const std::string& key, StatedUncertainty& stated, double most,
                   const std::string& unit) override;
  bool writes() const override { return true; }
  void matrix(const std::string& key, Eigen::Matrix3d& value, Range range) override;
  void numbers(const std::string& key, std::vector<double>& value, Range range) override;
  void integers(const std::string& key, std::array<int, 3>& value, int min, int max) override;
  void tables(const std::string& key, std::size_t size,
              const std::function<void(std::size_t)>& visit_entry) override;

  void table(const std::string& key, const std::function<void()>& visit_keys) override;

  /// The text written so far; the writer is empty afterwards.
  std::string take_text() { return std::move(text_); }

 private:
  void line(const std::string& key, const std::string& value) { text_ += key + " = " + value + "\n"; }

  std::string text_;
  std::string path_;
};

}  // namespace abcal
