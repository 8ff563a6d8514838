#include "app/laboratory/compare/covariance_table.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>

#include "app/system/read_file.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"
#include "protocol/plan/response_unit.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr std::string_view kTableHead = "quantity,value";
constexpr std::size_t kLargestTable = 100'000;

class TableOfCovariance {
 public:
  explicit TableOfCovariance(ComparedResult& result) : result_(result) {}

  void read(std::string_view text) {
    for (const std::string_view raw : pieces::split(text, '\n')) {
      ++line_;
      const std::string_view line = pieces::trimmed(raw);
      if (line.empty()) continue;
      if (line.starts_with('#'))
        comment(pieces::trimmed(line.substr(1)));
      else if (line.starts_with(kTableHead))
        has_head_ = true;
      else
        row(line);
    }
    if (!has_head_) problems_.push_back("no line \"quantity,value,...\"");
    if (result_.unit_name.empty()) problems_.push_back("no comment \"# response_unit: V\"");
    require_symmetry();
  }
  const std::vector<std::string>& problems() const { return problems_; }

 private:
  void problem(const std::string& what) { problems_.push_back(fmt::format("line {}: {}", line_, what)); }

  void comment(std::string_view text) {
    const std::size_t colon = text.find(':');
    if (colon == std::string_view::npos) return;
    const std::string_view key = pieces::trimmed(text.substr(0, colon));
    const std::string value(pieces::trimmed(text.substr(colon + 1)));
    if (key == "response_unit") result_.unit_name = value;
    if (key == "item_serial_number") result_.item_serial_number = result_.item = value;
    if (key == "date") result_.date = value;
    if (key == "stage") result_.stage = result_.stage_serial_number = value;
    if (key == "certificate") result_.what = value;
  }

  void row(std::string_view line) {
    const std::vector<std::string_view> cells = pieces::split(line, ',');
    const auto symbol = std::ranges::find(kIntrinsicSymbols, pieces::trimmed(cells.front()));
    if (symbol == kIntrinsicSymbols.end()) {
      problem(fmt::format("quantity \"{}\"; required: one of {}", pieces::trimmed(cells.front()),
                          fmt::join(kIntrinsicSymbols, ", ")));
      return;
    }
    if (cells.size() != 2 + kIntrinsicSymbols.size()) {
      problem(fmt::format("{} numbers; required: the value and 9 covariances", cells.size() - 1));
      return;
    }
    const auto at = static_cast<Eigen::Index>(symbol - kIntrinsicSymbols.begin());
    if (std::isfinite(result_.values(at))) problem(fmt::format("{} a second time", *symbol));
    result_.values(at) = number(cells[1]);
    for (Eigen::Index k = 0; k < 9; ++k)
      result_.covariance(at, k) = number(cells[static_cast<std::size_t>(k) + 2]);
  }

  double number(std::string_view cell) {
    const std::string_view digits = pieces::trimmed(cell);
    if (const auto value = pieces::number<double>(digits); value && std::isfinite(*value)) return *value;
    problem(fmt::format("\"{}\" is no number", digits));
    return std::numeric_limits<double>::quiet_NaN();
  }

  void require_symmetry() {
    constexpr double kRounding = 1e-6;
    for (Eigen::Index i = 0; i < 9; ++i)
      for (Eigen::Index j = 0; j < i; ++j) {
        const double a = result_.covariance(i, j), b = result_.covariance(j, i);
        const double u2 = std::sqrt(result_.covariance(i, i) * result_.covariance(j, j));
        if (std::isfinite(a) && std::isfinite(b) && std::abs(a - b) > kRounding * u2)
          problems_.push_back(fmt::format("the covariance of {} with {} is {}, and of {} with {} it is {}",
                                          kIntrinsicSymbols[static_cast<std::size_t>(i)],
                                          kIntrinsicSymbols[static_cast<std::size_t>(j)], a,
                                          kIntrinsicSymbols[static_cast<std::size_t>(j)],
                                          kIntrinsicSymbols[static_cast<std::size_t>(i)], b));
      }
  }

  ComparedResult& result_;
  std::vector<std::string> problems_;
  std::size_t line_ = 0;
  bool has_head_ = false;
};

}  // namespace

bool looks_like_covariance_table(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::string line;
  constexpr int kMostComments = 100;
  for (int k = 0; k < kMostComments && std::getline(file, line); ++k) {
    if (line.starts_with(kTableHead)) return true;
    if (!line.empty() && !line.starts_with('#')) return false;
  }
  return false;
}

ComparedResult read_covariance_table(const std::filesystem::path& path) {
  ComparedResult result;
  result.file = path.string();
  result.kind = "table";
  result.per_g_loc = false;
  result.values.setConstant(std::numeric_limits<double>::quiet_NaN());
  result.covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
  TableOfCovariance table(result);
  table.read(read_file(path, kLargestTable));
  if (!table.problems().empty())
    throw std::runtime_error(
        fmt::format("{}: cannot be read as a table of quantities with their covariance:\n  {}", path.string(),
                    fmt::join(table.problems(), "\n  ")));
  result.unit = meaning_of_response_unit(result.unit_name);
  result.sha256 = sha256_of_file(path);
  return result;
}

}  // namespace abcal
