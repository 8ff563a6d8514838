// abcal-mat: the constants of an accelerometer as a MATLAB file (version 5), and readings from one. Started
// by abcal (app/results/export/mat_format.h, app/results/logs/log_table.h), so that abcal need not load
// libmatio and its dependency HDF5.
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <matio.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <iterator>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
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

/// Columns of numbers with one name.
struct Columns {
  std::string name;
  std::vector<std::vector<double>> columns;  ///< All have one length.
};

template <class Number>
std::vector<double> as_numbers(const void* data, std::size_t count) {
  const auto* numbers = static_cast<const Number*>(data);
  return {numbers, numbers + count};
}

/// The elements by columns; nothing of a variable that is not real numbers in a matrix.
std::optional<std::vector<double>> elements_of(const matvar_t& variable) {
  if (variable.rank != 2 || variable.isComplex != 0 || variable.data == nullptr) return std::nullopt;
  const std::size_t count = variable.dims[0] * variable.dims[1];
  switch (variable.class_type) {
    case MAT_C_DOUBLE:
      return as_numbers<double>(variable.data, count);
    case MAT_C_SINGLE:
      return as_numbers<float>(variable.data, count);
    case MAT_C_INT8:
      return as_numbers<std::int8_t>(variable.data, count);
    case MAT_C_UINT8:
      return as_numbers<std::uint8_t>(variable.data, count);
    case MAT_C_INT16:
      return as_numbers<std::int16_t>(variable.data, count);
    case MAT_C_UINT16:
      return as_numbers<std::uint16_t>(variable.data, count);
    case MAT_C_INT32:
      return as_numbers<std::int32_t>(variable.data, count);
    case MAT_C_UINT32:
      return as_numbers<std::uint32_t>(variable.data, count);
    case MAT_C_INT64:
      return as_numbers<std::int64_t>(variable.data, count);
    case MAT_C_UINT64:
      return as_numbers<std::uint64_t>(variable.data, count);
    default:
      return std::nullopt;
  }
}

/// Adds a variable, or the fields of a structure. A matrix that is wider than long has its readings in rows.
void add_columns(const matvar_t& variable, std::vector<Columns>& found) {
  if (variable.class_type == MAT_C_STRUCT && variable.dims[0] * variable.dims[1] == 1) {
    auto* structure = const_cast<matvar_t*>(&variable);
    for (unsigned i = 0; i < Mat_VarGetNumberOfFields(structure); ++i)
      if (const matvar_t* field = Mat_VarGetStructFieldByIndex(structure, i, 0)) add_columns(*field, found);
    return;
  }
  const auto numbers = elements_of(variable);
  if (!numbers || variable.name == nullptr) return;
  const std::size_t rows = variable.dims[0], columns = variable.dims[1];
  const bool across = columns > rows;
  const std::size_t length = std::max(rows, columns), width = std::min(rows, columns);
  Columns& added = found.emplace_back(Columns{variable.name, {}});
  for (std::size_t k = 0; k < width; ++k) {
    std::vector<double>& column = added.columns.emplace_back();
    for (std::size_t i = 0; i < length; ++i)
      column.push_back(numbers->at(across ? i * width + k : k * length + i));
  }
}

/// Writes the columns of the length that most numbers have as a table. The names of vectors are those of the
/// variables; the columns of one matrix with three are x, y, z, those of one with four t, x, y, z.
void write_table(const std::string& path, const std::string& output) {
  const std::unique_ptr<mat_t, int (*)(mat_t*)> file(Mat_Open(path.c_str(), MAT_ACC_RDONLY), Mat_Close);
  if (!file) throw std::runtime_error(fmt::format("{}: is no MATLAB file that libmatio reads", path));
  std::vector<Columns> found;
  while (matvar_t* next = Mat_VarReadNext(file.get())) {
    const std::unique_ptr<matvar_t, void (*)(matvar_t*)> variable(next, Mat_VarFree);
    add_columns(*variable, found);
  }
  const auto length = [](const Columns& each) {
    return each.columns.empty() ? 0 : each.columns.front().size();
  };
  std::map<std::size_t, std::size_t> numbers;
  for (const Columns& each : found) numbers[length(each)] += length(each) * each.columns.size();
  numbers.erase(0);
  const auto most = std::ranges::max_element(numbers, {}, [](const auto& entry) { return entry.second; });
  std::vector<std::string> names;
  std::vector<const std::vector<double>*> columns;
  for (const Columns& each : found) {
    if (most == numbers.end() || length(each) != most->first) continue;
    const std::size_t width = each.columns.size();
    static constexpr std::array kAxes{"x", "y", "z"}, kWithTime{"t", "x", "y"};
    for (std::size_t k = 0; k < width; ++k) {
      columns.push_back(&each.columns[k]);
      names.push_back(width == 3            ? kAxes.at(k)
                      : width == 4 && k < 3 ? kWithTime.at(k)
                      : width == 4          ? "z"
                      : width == 1          ? each.name
                                            : fmt::format("{}_{}", each.name, k + 1));
    }
  }
  if (columns.size() < 3)
    throw std::runtime_error(
        fmt::format("{}: found {} columns of numbers of one length; required: three readings x, y, z, and a "
                    "time where there is one",
                    path, columns.size()));
  std::string text = fmt::format("{}\n", fmt::join(names, ","));
  for (std::size_t i = 0; i < most->first; ++i) {
    for (std::size_t k = 0; k < columns.size(); ++k)
      fmt::format_to(std::back_inserter(text), "{}{}", k > 0 ? "," : "", columns[k]->at(i));
    text += '\n';
  }
  std::ofstream(output, std::ios::binary) << text;
}

void add_read(CLI::App& parent) {
  struct Options {
    std::string file, output;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("read", "Write the readings of a MATLAB file as a table");
  command->add_option("FILE", options->file, "MATLAB file, versions 5 to 7.3")->required();
  command->add_option("OUTPUT", options->output, "table to write")->required();
  command->callback([options] { write_table(options->file, options->output); });
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
  return abcal::run_program(
      argc, argv,
      {"abcal-mat",
       "abcal-mat writes the MATLAB files of `abcal export --as mat`, and reads those with "
       "readings.",
       [](CLI::App& app, int&) {
         add_write(app);
         add_read(app);
       }});
}
