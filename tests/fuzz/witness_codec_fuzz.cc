// Fuzz target of the lines of a witness: whatever bytes a run file holds in place of a line, they are
// accepted exactly if a slow reference, which reads them from the front to the end, accepts them; and a
// request that is accepted comes through its JSON as it is.
//
// With clang: -fsanitize=fuzzer,address,undefined (CMake option ABCAL_FUZZ). With any compiler:
// witness_codec_fuzz_test feeds it a fixed number of seeded inputs.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <string_view>

#include "app/witness/witness_line.h"

namespace {

void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "line of a witness and reference differ: %s\n", what);
  std::abort();
}

/// Takes the parts of a line off its front. Once one is missing, is_good() stays false.
class Reference {
 public:
  explicit Reference(std::string_view line) : rest_(line) {}

  bool is_good() const { return good_; }

  /// Whether these bytes are next; they are taken then.
  bool has(std::string_view bytes) {
    if (!rest_.starts_with(bytes)) return false;
    rest_.remove_prefix(bytes.size());
    return true;
  }

  void expect(std::string_view bytes) { good_ = has(bytes) && good_; }

  void number(long long least, unsigned long long most) {
    std::size_t digits = 0;
    unsigned long long value = 0;
    while (digits < rest_.size() && digits < 19 && is_between(rest_[digits], '0', '9'))
      value = 10 * value + static_cast<unsigned long long>(rest_[digits++] - '0');
    good_ = good_ && digits > 0 && (digits == 1 || rest_[0] != '0') &&
            value >= static_cast<unsigned long long>(least) && value <= most;
    rest_.remove_prefix(digits);
  }

  std::string text() {
    std::string value;
    expect("\"");
    while (good_ && !has("\"")) {
      if (has("\\\"")) {
        value += '"';
      } else if (has("\\\\")) {
        value += '\\';
      } else if (has("\\n")) {
        value += '\n';
      } else if (has("\\t")) {
        value += '\t';
      } else {
        value += character();
      }
    }
    return value;
  }

  void identity(bool may_be_empty) {
    const std::string value = text();
    good_ = good_ && value.size() <= 200 && (may_be_empty || !value.empty());
  }

  void link() {
    const std::string value = text();
    good_ = good_ && value.size() == 64;
    for (const char c : value) good_ = good_ && (is_between(c, '0', '9') || is_between(c, 'a', 'f'));
  }

  void utc() {
    static constexpr std::string_view kPattern = "dddd-dd-ddTdd:dd:dd.dddZ";
    const std::string value = text();
    good_ = good_ && value.size() == kPattern.size();
    for (std::size_t k = 0; good_ && k < kPattern.size(); ++k)
      good_ = kPattern[k] == 'd' ? is_between(value[k], '0', '9') : value[k] == kPattern[k];
    if (!good_) return;
    const auto part = [&](std::size_t at, std::size_t count) { return std::stoi(value.substr(at, count)); };
    const int year = part(0, 4), month = part(5, 2), day = part(8, 2);
    static constexpr int kDays[] = {31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
    good_ = month >= 1 && month <= 12;
    if (!good_) return;
    const bool is_leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
    good_ = day >= 1 && day <= kDays[month - 1] + (month == 2 && is_leap ? 1 : 0) && part(11, 2) <= 23 &&
            part(14, 2) <= 59 && part(17, 2) <= 59;
  }

  void end() { good_ = good_ && rest_.empty(); }

 private:
  static bool is_between(char c, char least, char most) { return c >= least && c <= most; }

  /// One character of UTF-8 that needs no escape.
  std::string character() {
    const auto byte = [&](std::size_t k) {
      return k < rest_.size() ? static_cast<unsigned>(static_cast<unsigned char>(rest_[k])) : 0U;
    };
    const unsigned first = byte(0);
    std::size_t size = 0;
    unsigned code = 0;
    if (first >= 0x20 && first < 0x80) {
      size = 1;
      code = first;
    } else if (first >= 0xc0 && first < 0xe0) {
      size = 2;
      code = first & 0x1fU;
    } else if (first >= 0xe0 && first < 0xf0) {
      size = 3;
      code = first & 0x0fU;
    } else if (first >= 0xf0 && first < 0xf8) {
      size = 4;
      code = first & 0x07U;
    }
    for (std::size_t k = 1; k < size; ++k) {
      good_ = good_ && (byte(k) & 0xc0U) == 0x80U;
      code = (code << 6U) + (byte(k) & 0x3fU);
    }
    static constexpr unsigned kLeast[] = {0, 0, 0x80, 0x800, 0x10000};
    good_ = good_ && size > 0 && code >= kLeast[size] && code <= 0x10ffff &&
            (code < 0xd800 || code > 0xdfff) && code != '\\';
    if (!good_) return {};
    const std::string taken(rest_.substr(0, size));
    rest_.remove_prefix(size);
    return taken;
  }

  std::string_view rest_;
  bool good_ = true;
};

constexpr unsigned long long kMost = 9'223'372'036'854'775'807ULL;

bool reference_accepts(std::string_view line) {
  Reference reference(line);
  reference.expect(R"({"schema":"abcal.witness/1","counter":)");
  const bool is_first = line.substr(0, 40).find(R"("counter":1,)") != std::string_view::npos;
  reference.number(1, kMost);
  reference.expect(R"(,"utc":)");
  reference.utc();
  reference.expect(R"(,"boot_id":)");
  reference.identity(true);
  reference.expect(R"(,"since_boot_ns":)");
  reference.number(0, kMost);
  reference.expect(R"(,"uid":)");
  reference.number(0, 4'294'967'295ULL);
  if (reference.has(R"(,"do":"begin","run":)")) {
    reference.identity(false);
    reference.expect(R"(,"bench":)");
    reference.identity(true);
    reference.expect(R"(,"person":)");
    reference.identity(true);
    reference.expect(R"(,"head":)");
    reference.link();
    reference.expect(R"(,"simulated":)");
    if (!reference.has("true")) reference.expect("false");
  } else if (reference.has(R"(,"do":"link","run":)")) {
    reference.identity(false);
    reference.expect(R"(,"k":)");
    reference.number(1, kMost);
    reference.expect(R"(,"previous":)");
    reference.link();
    reference.expect(R"(,"this":)");
    reference.link();
  } else if (reference.has(R"(,"do":"close","run":)")) {
    reference.identity(false);
    reference.expect(R"(,"k":)");
    reference.number(0, kMost);
    reference.expect(R"(,"this":)");
    reference.link();
    reference.expect(R"(,"events":)");
    reference.link();
  } else {
    reference.expect(R"(,"do":"head","register":)");
    reference.identity(false);
    reference.expect(R"(,"entries":)");
    reference.number(0, kMost);
    reference.expect(R"(,"head":)");
    reference.link();
  }
  reference.expect(R"(,"log":)");
  if (is_first) {
    reference.expect(R"("")");
  } else {
    reference.link();
  }
  reference.expect("}");
  reference.end();
  return reference.is_good();
}

bool accepts(const std::string& line) {
  try {
    const abcal::WitnessStatement statement = abcal::parse_witness_line(line);
    require(abcal::to_line(statement) == line, "its bytes");
    abcal::require_valid(statement);
    return true;
  } catch (const std::invalid_argument&) {
    return false;
  }
}

void read_request(const std::string& json) {
  abcal::WitnessRequest request;
  try {
    request = abcal::parse_witness_request(json);
  } catch (const std::invalid_argument&) {
    return;
  }
  abcal::require_valid(request);
  require(abcal::parse_witness_request(abcal::to_json(request)) == request, "a request");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  require(accepts(bytes) == reference_accepts(bytes), "whether it is one");
  read_request(bytes);
  return 0;
}
