// abcal-mat: the constants of an accelerometer as a MATLAB file (version 5). Started by abcal
// (app/results/export/mat_format.h), so that abcal need not load libmatio and its dependency HDF5.
#include <fmt/format.h>
#include <matio.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/run_program.h"
#include "app/system/read_file.h"

namespace {

/// A MATLAB file, version 5, as libmatio writes it.
class MatFile {
 public:
  explicit MatFile(const std::string& path)
      : path_(path),
        file_(Mat_CreateVer(path.c_str(), "MATLAB 5.0 MAT-file, constants of an accelerometer by abcal",
                            MAT_FT_MAT5),
              Mat_Close) {
    if (!file_) throw std::runtime_error(fmt::format("{} cannot be written", path));
  }

  /// @param rows  of equal length
  void add(const char* name, const std::vector<std::vector<double>>& rows) {
    std::array<std::size_t, 2> size{rows.size(), rows.front().size()};
    std::vector<double> by_columns;
    for (std::size_t k = 0; k < size[1]; ++k)
      for (const std::vector<double>& row : rows) by_columns.push_back(row.at(k));
    write(name, MAT_C_DOUBLE, MAT_T_DOUBLE, size, by_columns.data());
  }

  void add(const char* name, std::string text) {
    std::array<std::size_t, 2> size{1, text.size()};
    write(name, MAT_C_CHAR, MAT_T_UTF8, size, text.data());
  }

 private:
  void write(const char* name, matio_classes kind, matio_types type, std::array<std::size_t, 2> size,
             void* data) {
    const std::unique_ptr<matvar_t, void (*)(matvar_t*)> variable(
        Mat_VarCreate(name, kind, type, 2, size.data(), data, 0), Mat_VarFree);
    if (!variable || Mat_VarWrite(file_.get(), variable.get(), MAT_COMPRESSION_NONE) != 0)
      throw std::runtime_error(fmt::format("{}: {} cannot be written", path_, name));
  }

  std::string path_;
  std::unique_ptr<mat_t, int (*)(mat_t*)> file_;
};

/// Coefficients of polynomials as rows of one length, with zeros behind.
std::vector<std::vector<double>> rows_of(const std::vector<std::vector<double>>& coefficients) {
  std::size_t terms = 1;
  for (const std::vector<double>& each : coefficients) terms = std::max(terms, each.size());
  std::vector<std::vector<double>> rows = coefficients;
  for (std::vector<double>& row : rows) row.resize(terms, 0.0);
  return rows;
}

/// One row for each polynomial: M_xu, M_xv, ... M_zw; b, s: u, v, w; phi: uv, vw, wu.
/// @param constants  schema abcal.temperature_constants/1
void write_over_temperature(const nlohmann::json& constants, MatFile& file) {
  std::vector<std::vector<double>> matrix;
  for (const auto& row : constants.at("M").at("coefficients"))
    for (const auto& element : row) matrix.push_back(element.get<std::vector<double>>());
  file.add("M", rows_of(matrix));
  const auto& outputs = constants.at("outputs");
  for (const auto& [name, first] : {std::pair{"s", 0U}, {"phi", 3U}, {"b", 6U}}) {
    std::vector<std::vector<double>> values, uncertainties;
    for (std::size_t k = first; k < first + 3U; ++k) {
      const auto covariance = outputs.at(k).at("covariance").get<std::vector<std::vector<double>>>();
      values.push_back(outputs.at(k).at("coefficients").get<std::vector<double>>());
      std::vector<double>& u = uncertainties.emplace_back();
      for (std::size_t n = 0; n < covariance.size(); ++n) u.push_back(std::sqrt(covariance[n].at(n)));
    }
    file.add(name, rows_of(values));
    file.add((std::string("u_") + name).c_str(), rows_of(uncertainties));
  }
  for (const char* name : {"T0_degc", "least_degc", "most_degc", "g_loc_mps2"})
    file.add(name, std::vector<std::vector<double>>(1, {constants.at(name).get<double>()}));
}

/// @param constants  schema abcal.constants/1 or abcal.temperature_constants/1
void write_mat(const nlohmann::json& constants, const std::string& path) {
  MatFile file(path);
  for (const char* name : {"rule", "response_unit", "frame", "item", "source", "performed", "verdict"})
    file.add(name, constants.at(name).get<std::string>());
  if (constants.at("schema") == "abcal.temperature_constants/1") {
    write_over_temperature(constants, file);
    return;
  }
  const auto column = [](const nlohmann::json& numbers) {
    std::vector<std::vector<double>> rows;
    for (const auto& number : numbers) rows.push_back({number.get<double>()});
    return rows;
  };
  const auto& matrix = constants.at("M");
  const auto& offset = constants.at("b");
  file.add("M", matrix.at("value").get<std::vector<std::vector<double>>>());
  file.add("u_M", matrix.at("standard_uncertainty").get<std::vector<std::vector<double>>>());
  file.add("b", column(offset.at("value")));
  file.add("u_b", column(offset.at("standard_uncertainty")));
  file.add("g_loc_mps2", column(nlohmann::json::array({constants.at("g_loc_mps2")})));
  for (const auto& [name, output] : constants.at("outputs").items()) {
    const nlohmann::json& u = output.at("standard_uncertainty");
    file.add(name.c_str(), column(nlohmann::json::array({output.at("value")})));
    if (u.is_number()) file.add(("u_" + name).c_str(), column(nlohmann::json::array({u})));
  }
  if (!constants.contains("noise")) return;
  const auto& noise = constants.at("noise");
  file.add("noise_density", column(nlohmann::json::array({noise.at("density")})));
  file.add("rate_hz", column(nlohmann::json::array({noise.at("rate_hz")})));
}

void add_write(CLI::App& parent) {
  struct Options {
    std::string constants, output;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("write", "Write constants as a MATLAB file");
  command->add_option("CONSTANTS", options->constants, "what `abcal export --as json` writes")->required();
  command->add_option("OUTPUT", options->output, "file to write; what is there is replaced")->required();
  command->callback(
      [options] { write_mat(nlohmann::json::parse(abcal::read_file(options->constants)), options->output); });
}

}  // namespace

int main(int argc, char** argv) {
  return abcal::run_program(argc, argv,
                            {"abcal-mat", "abcal-mat writes the MATLAB files of `abcal export --as mat`.",
                             [](CLI::App& app, int&) { add_write(app); }});
}
