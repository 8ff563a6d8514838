#include "app/witness/witness_line.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <limits>
#include <nlohmann/json.hpp>
#include <string_view>

#include "app/document/valid_text.h"
#include "drivers/text/names.h"
#include "protocol/record/signature.h"

namespace abcal {
namespace {

using OrderedJson = nlohmann::ordered_json;

constexpr const char* kSchema = "abcal.witness/1";
constexpr auto kActs = names<WitnessAct>({{WitnessAct::kBegin, "begin"},
                                          {WitnessAct::kLink, "link"},
                                          {WitnessAct::kClose, "close"},
                                          {WitnessAct::kHead, "head"}});

/// Values that a member may hold.
enum class Rule {
  kText,      ///< UTF-8 of at most kLongestWitnessedText bytes.
  kIdentity,  ///< Like a text, not empty.
  kUtc,       ///< As format_utc() writes it.
  kLink,      ///< SHA-256.
  kOrdinal,   ///< A number from 1.
  kCount,     ///< A number from 0.
  kFlag,
};

/// Calls visit(name, rule, member) for each member of the request's act, in the order of a line.
template <class Request, class Visit>
void visit_request(Request& request, const Visit& visit) {
  switch (request.what) {
    case WitnessAct::kBegin:
      visit("run", Rule::kIdentity, request.run);
      visit("bench", Rule::kText, request.bench);
      visit("person", Rule::kText, request.person);
      visit("head", Rule::kLink, request.head);
      visit("simulated", Rule::kFlag, request.simulated);
      return;
    case WitnessAct::kLink:
      visit("run", Rule::kIdentity, request.run);
      visit("k", Rule::kOrdinal, request.k);
      visit("previous", Rule::kLink, request.previous);
      visit("this", Rule::kLink, request.now);
      return;
    case WitnessAct::kClose:
      visit("run", Rule::kIdentity, request.run);
      visit("k", Rule::kCount, request.k);
      visit("this", Rule::kLink, request.now);
      visit("events", Rule::kLink, request.events);
      return;
    case WitnessAct::kHead:
      visit("register", Rule::kIdentity, request.register_identity);
      visit("entries", Rule::kCount, request.entries);
      visit("head", Rule::kLink, request.head);
      return;
  }
}

/// The same for what the witness adds before the request. "log", which follows it, has a rule of its own.
template <class Statement, class Visit>
void visit_circumstances(Statement& statement, const Visit& visit) {
  visit("counter", Rule::kOrdinal, statement.counter);
  visit("utc", Rule::kUtc, statement.utc);
  visit("boot_id", Rule::kText, statement.boot_id);
  visit("since_boot_ns", Rule::kCount, statement.since_boot_ns);
  visit("uid", Rule::kCount, statement.uid);
}

[[noreturn]] void refuse_member(std::string_view member, std::string_view found, std::string_view required) {
  throw std::invalid_argument(fmt::format("\"{}\": found {}; required: {}", member, found, required));
}

bool is_sha256(std::string_view text) {
  return text.size() == 64 && text.find_first_not_of("0123456789abcdef") == std::string_view::npos;
}

bool is_utc(std::string_view text) {
  constexpr std::string_view kPattern = "0000-00-00T00:00:00.000Z";
  const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
  if (!std::ranges::equal(text, kPattern,
                          [&](char c, char wanted) { return wanted == '0' ? is_digit(c) : c == wanted; }))
    return false;
  const auto number = [&](std::size_t at, std::size_t digits) {
    int value = 0;
    for (const char c : text.substr(at, digits)) value = 10 * value + (c - '0');
    return value;
  };
  const std::chrono::year_month_day day{std::chrono::year(number(0, 4)),
                                        std::chrono::month(static_cast<unsigned>(number(5, 2))),
                                        std::chrono::day(static_cast<unsigned>(number(8, 2)))};
  return day.ok() && number(11, 2) < 24 && number(14, 2) < 60 && number(17, 2) < 60;
}

void require_member(std::string_view name, Rule rule, const std::string& value) {
  // The value itself may be long, and anything.
  const std::string found = fmt::format("{} bytes", value.size());
  if (rule == Rule::kLink) {
    if (!is_sha256(value)) refuse_member(name, found, "SHA-256 as 64 hexadecimal digits in lower case");
    return;
  }
  if (rule == Rule::kUtc) {
    if (!is_utc(value)) refuse_member(name, found, "a time such as 2026-03-01T12:00:00.000Z");
    return;
  }
  if (value.size() > kLongestWitnessedText)
    refuse_member(name, found, fmt::format("at most {} bytes", kLongestWitnessedText));
  if (value.empty() && rule == Rule::kIdentity) refuse_member(name, "an empty text", "an identity");
  if (valid_text(value) != value)
    refuse_member(name, "bytes that are no text", "UTF-8 without control characters");
}

void require_member(std::string_view name, Rule rule, std::int64_t value) {
  const std::int64_t least = rule == Rule::kOrdinal ? 1 : 0;
  if (value < least) refuse_member(name, fmt::to_string(value), fmt::format("a number from {}", least));
}

void require_member(std::string_view, Rule, bool) {}

constexpr auto kRequire = [](std::string_view name, Rule rule, const auto& value) {
  require_member(name, rule, value);
};

const OrderedJson& member_of(const OrderedJson& json, const char* name) {
  const auto found = json.find(name);
  if (found == json.end()) refuse_member(name, "nothing", "this member");
  return *found;
}

void read(const OrderedJson& json, const char* name, std::string& value) {
  const OrderedJson& member = member_of(json, name);
  if (!member.is_string()) refuse_member(name, member.type_name(), "a text");
  value = member.get<std::string>();
}

void read(const OrderedJson& json, const char* name, std::int64_t& value) {
  const OrderedJson& member = member_of(json, name);
  if (!member.is_number_integer()) refuse_member(name, member.type_name(), "a whole number");
  // One above 2^63 becomes negative, which no member may be.
  value = member.get<std::int64_t>();
}

void read(const OrderedJson& json, const char* name, bool& value) {
  const OrderedJson& member = member_of(json, name);
  if (!member.is_boolean()) refuse_member(name, member.type_name(), "true or false");
  value = member.get<bool>();
}

OrderedJson parse_object(const std::string& text) {
  OrderedJson json = OrderedJson::parse(text, nullptr, false);
  if (!json.is_object()) throw std::invalid_argument("found no JSON object; required: one");
  return json;
}

std::string text_of(const OrderedJson& json, const char* name) {
  std::string text;
  read(json, name, text);
  return text;
}

/// Reads "do" and the members that it has, and checks them.
WitnessRequest request_in(const OrderedJson& json) {
  WitnessRequest request;
  request.what = witness_act_from(text_of(json, "do"));
  visit_request(request, [&](const char* name, Rule rule, auto& value) {
    read(json, name, value);
    require_member(name, rule, value);
  });
  return request;
}

void add_request(OrderedJson& json, const WitnessRequest& request) {
  json["do"] = to_string(request.what);
  visit_request(request, [&](const char* name, Rule, const auto& value) { json[name] = value; });
}

}  // namespace

std::string_view to_string(WitnessAct act) {
  return kActs.of(act);
}

WitnessAct witness_act_from(const std::string& name) {
  const auto act = kActs.value(name);
  if (!act) refuse_member("do", "another text", fmt::format("{}", fmt::join(kActs.all(), ", ")));
  return *act;
}

void require_valid(const WitnessRequest& request) {
  visit_request(request, kRequire);
}

std::string to_line(const WitnessStatement& statement) {
  OrderedJson json;
  json["schema"] = kSchema;
  visit_circumstances(statement, [&](const char* name, Rule, const auto& value) { json[name] = value; });
  add_request(json, statement);
  json["log"] = statement.before;
  return json.dump();
}

WitnessStatement parse_witness_line(const std::string& line) {
  const OrderedJson json = parse_object(line);
  if (text_of(json, "schema") != kSchema) refuse_member("schema", "another one", kSchema);
  WitnessStatement statement;
  static_cast<WitnessRequest&>(statement) = request_in(json);
  visit_circumstances(statement, [&](const char* name, Rule rule, auto& value) {
    read(json, name, value);
    require_member(name, rule, value);
  });
  if (statement.uid > std::int64_t{std::numeric_limits<std::uint32_t>::max()})
    refuse_member("uid", fmt::to_string(statement.uid), "a number below 2^32");
  read(json, "log", statement.before);
  if (statement.counter == 1 ? !statement.before.empty() : !is_sha256(statement.before))
    refuse_member("log", fmt::format("{} bytes", statement.before.size()),
                  "SHA-256 of the line before, empty in line 1 only");
  if (to_line(statement) != line)
    throw std::invalid_argument(
        "found other members, another order or other blanks; required: the bytes that a witness writes");
  return statement;
}

std::string to_json(const WitnessRequest& request) {
  OrderedJson json;
  add_request(json, request);
  return json.dump();
}

WitnessRequest parse_witness_request(const std::string& text) {
  const OrderedJson json = parse_object(text);
  WitnessRequest request = request_in(json);
  OrderedJson known;
  add_request(known, request);
  for (const auto& [name, value] : json.items())
    if (!known.contains(name)) refuse_member(name, "a member that is not known", "none of this name");
  return request;
}

bool is_witnessed_by(const WitnessedLine& witnessed, const std::string& public_pem) {
  return is_signature(witnessed.line, witnessed.signature, public_pem);
}

}  // namespace abcal
