#include "app/commands/accelerometer_file.h"

#include <fmt/format.h>

#include <fstream>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <vector>

namespace abcal {
namespace {

double plain_number(const nlohmann::json& json) {
  const nlohmann::json& value = json.is_object() && json.contains("value") ? json.at("value") : json;
  return value.get<double>();
}

/// @throws nlohmann::json::exception, std::invalid_argument
AccelerometerUnderTest from_json(const std::string& text) {
  const nlohmann::json json = nlohmann::json::parse(text);
  const nlohmann::json& rows = json.at("sensitivity_matrix");
  const nlohmann::json& offset = json.at("offset");
  if (rows.size() != 3 || offset.size() != 3) throw std::invalid_argument("3 rows and 3 offsets are needed");
  AccelerometerUnderTest accelerometer;
  for (std::size_t j = 0; j < 3; ++j) {
    if (rows.at(j).size() != 3) throw std::invalid_argument("a row does not have 3 elements");
    const auto row = static_cast<Eigen::Index>(j);
    for (std::size_t k = 0; k < 3; ++k) {
      accelerometer.sensitivity_matrix(row, static_cast<Eigen::Index>(k)) = plain_number(rows.at(j).at(k));
    }
    accelerometer.offset(row) = plain_number(offset.at(j));
  }
  return accelerometer;
}

/// Numbers separated by spaces, commas or semicolons; text after a # is a comment.
/// @throws std::invalid_argument
std::vector<double> numbers_in(std::string text) {
  for (char& c : text) {
    if (c == ',' || c == ';') c = ' ';
  }
  std::istringstream stream(text);
  std::vector<double> numbers;
  for (std::string word; stream >> word;) {
    if (word.front() == '#') {
      stream.ignore(std::numeric_limits<std::streamsize>::max(), '\n');
      continue;
    }
    std::size_t used = 0;
    try {
      numbers.push_back(std::stod(word, &used));
    } catch (const std::exception&) {
      used = 0;
    }
    if (used != word.size()) throw std::invalid_argument(fmt::format("\"{}\" is not a number", word));
  }
  return numbers;
}

/// @throws std::invalid_argument
AccelerometerUnderTest from_numbers(const std::vector<double>& numbers) {
  if (numbers.size() != 12) {
    throw std::invalid_argument(
        fmt::format("{} numbers, 12 are needed (s row by row, then O)", numbers.size()));
  }
  AccelerometerUnderTest accelerometer;
  for (Eigen::Index k = 0; k < 9; ++k) {
    accelerometer.sensitivity_matrix(k / 3, k % 3) = numbers[static_cast<std::size_t>(k)];
  }
  for (Eigen::Index j = 0; j < 3; ++j) accelerometer.offset(j) = numbers[static_cast<std::size_t>(9 + j)];
  return accelerometer;
}

}  // namespace

AccelerometerUnderTest read_accelerometer(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::invalid_argument(fmt::format("accelerometer file {} cannot be read", path.string()));
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const std::size_t start = text.find_first_not_of(" \t\r\n");
  const bool is_json = start != std::string::npos && text[start] == '{';
  try {
    const AccelerometerUnderTest accelerometer = is_json ? from_json(text) : from_numbers(numbers_in(text));
    if (!accelerometer.sensitivity_matrix.allFinite() || !accelerometer.offset.allFinite()) {
      throw std::invalid_argument("a number is not finite");
    }
    return accelerometer;
  } catch (const std::exception& error) {
    throw std::invalid_argument(fmt::format("accelerometer file {}: {}", path.string(), error.what()));
  }
}

}  // namespace abcal
