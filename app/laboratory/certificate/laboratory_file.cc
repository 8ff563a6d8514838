#include "app/laboratory/certificate/laboratory_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>

#include "app/formats/toml_reader.h"
#include "app/laboratory/certificate/derived.h"
#include "app/laboratory/certificate/iso_codes.h"
#include "app/laboratory/certificate/words.h"
#include "app/laboratory/register/records.h"
#include "drivers/text/names.h"

namespace abcal {
namespace {

void read_contact(TomlReader& keys, Contact& contact) {
  keys.required_text("name", contact.name);
  keys.text("street", contact.street);
  keys.text("post_code", contact.post_code);
  keys.required_text("city", contact.city);
  keys.text("state", contact.state);
  keys.required_text("country_code", contact.country_code);
  keys.text("email", contact.email);
  keys.text("phone", contact.phone);
  if (!contact.country_code.empty() && !is_country_code(contact.country_code)) {
    keys.add_problem_at(keys.line(), keys.name("country_code"), "\"" + contact.country_code + "\"",
                        "a country code of ISO 3166-1, such as \"DE\"");
  }
}

void read_laboratory(TomlReader& keys, Laboratory& laboratory, std::string& language) {
  keys.section("laboratory");
  read_contact(keys, laboratory.contact);
  if (laboratory.contact.street.empty())
    keys.add_missing("street", "its address: a street and number, or a post office box");
  keys.text("language", language, Words::languages());
  keys.text("accreditation", laboratory.accreditation);
  keys.text("performance_location", laboratory.performance_location,
            {"laboratory", "customer", "laboratoryBranch", "customerBranch", "other"});
  keys.text("gravity_site", laboratory.gravity_site);
  keys.number("latitude_deg", laboratory.latitude_deg, {-90.0, 90.0});
  keys.number("longitude_deg", laboratory.longitude_deg, {-180.0, 180.0});
  keys.number("height_m", laboratory.height_m, {-500.0, 9000.0});
  keys.text("record_of_own_item", laboratory.record_of_own_item, {"refused", "stated"});
  if (laboratory.latitude_deg.has_value() != laboratory.longitude_deg.has_value())
    keys.add_missing(laboratory.latitude_deg ? "longitude_deg" : "latitude_deg", "both, or neither");
}

void read_customer(TomlReader& keys, Contact& customer) {
  keys.section("customer");
  read_contact(keys, customer);
  if (customer.street.empty() && customer.email.empty() && customer.phone.empty())
    keys.add_missing("street", "how to reach the customer: street, email or phone");
}

void read_job(TomlReader& keys, Job& job) {
  keys.section("job");
  keys.text("item_name", job.item_name);
  keys.required_text("condition", job.condition);
  keys.text("owner_id", job.owner_id);
  keys.text("order", job.order);
  keys.date("received", job.received);
  keys.text("procedure", job.procedure);
  keys.text("sampling", job.sampling);
  keys.text("deviations", job.deviations);
  keys.text("external_results", job.external_results);
  keys.text("opinions", job.opinions);
  keys.text("adjustment", job.adjustment);
  keys.texts("customer_supplied", job.customer_supplied);
  keys.date("recalibration", job.recalibration);
}

void read_persons(TomlReader& keys, std::vector<Person>& persons) {
  keys.section("");
  keys.tables("person", 0, [&](std::size_t) {
    Person& person = persons.emplace_back();
    keys.required_text("name", person.name);
    keys.required_text("role", person.role);
    keys.text("email", person.email);
    keys.texts("may", person.may, {"measure", "approve"});
  });
  const auto who_may = [&](const std::string& word) {
    std::vector<std::string> names;
    for (const Person& person : persons)
      if (std::find(person.may.begin(), person.may.end(), word) != person.may.end())
        names.push_back(person.name);
    return names;
  };
  const std::vector<std::string> measuring = who_may("measure"), approving = who_may("approve");
  if (measuring.empty())
    keys.add_problem("person", "no person who may measure", "a [[person]] with may = [\"measure\"]");
  if (approving.empty())
    keys.add_problem("person", "no person who may approve", "a [[person]] with may = [\"approve\"]");
  if (approving.size() == 1 && measuring == approving)
    keys.add_problem("person", measuring.front() + " alone, to measure and to approve",
                     "two persons: the one who measured cannot approve");
}

void read_equipment(TomlReader& keys, std::vector<Equipment>& equipment) {
  keys.section("");
  keys.tables("equipment", 0, [&](std::size_t) {
    Equipment& one = equipment.emplace_back();
    one.line = keys.line();
    keys.required_text("name", one.name);
    keys.text("maker", one.maker);
    keys.text("model", one.model);
    keys.required_text("serial_number", one.serial_number);
    keys.required_text("quantity", one.quantity,
                       {"angle", "gravity", "voltage", "temperature", "humidity", "pressure", "level",
                        lab::kStageRecordQuantity, "other"});
    keys.required_text("certificate", one.certificate);
    keys.required_text("certificate_issuer", one.certificate_issuer);
    keys.text("certificate_sha256", one.certificate_sha256);
    keys.date("performed", one.performed);
    keys.date("due", one.due);
    if (one.performed && one.due && *one.due < *one.performed)
      keys.add_problem_at(one.line, "equipment.due", format_date(*one.due), "not before it was performed");
    if (one.quantity == lab::kStageRecordQuantity && one.certificate_sha256.empty())
      keys.add_missing("certificate_sha256", "the SHA-256 of the record, which `abcal stage show` prints");
    if (!keys.has("due")) keys.add_missing("due", "the date until which its calibration holds, 2027-03-01");
  });
  const auto angle = [](const Equipment& one) { return one.quantity == "angle"; };
  if (std::none_of(equipment.begin(), equipment.end(), angle)) {
    keys.add_problem("equipment", "no entry that makes the angle of the stage traceable",
                     "an [[equipment]] with quantity = \"angle\": the stage, with its certificate");
  }
}

void read_decision(TomlReader& keys, LaboratoryFile& file) {
  keys.section("decision");
  DecisionRule rule;
  std::string kind;
  keys.text("rule", kind, kDecisionRules.all());
  keys.number("guard_factor", rule.guard_factor, {-1.0, 10.0});
  keys.text("agreement", rule.agreement);
  if (!kind.empty()) {
    rule.kind = kDecisionRules.value(kind).value_or(rule.kind);
    if (rule.agreement.empty())
      keys.add_missing("agreement", "where the customer agreed to the rule before measuring");
    if (rule.kind == DecisionKind::kNonBinary && !(rule.guard_factor >= 0.0))
      keys.add_problem("decision.guard_factor", fmt::format("{}", rule.guard_factor), ">= 0 for this rule");
    file.decision = rule;
  }
  keys.section("");
  const std::vector<std::string> names = names_of_quantities();
  keys.tables("limit", 0, [&](std::size_t) {
    SpecificationLimit& limit = file.limits.emplace_back();
    limit.line = keys.line();
    keys.required_text("quantity", limit.quantity, names);
    keys.required_text("unit", limit.unit);
    keys.number("lower", limit.lower, kAny);
    keys.number("upper", limit.upper, kAny);
    keys.required_text("source", limit.source);
    if (!keys.has("lower") && !keys.has("upper"))
      keys.add_missing("lower", "a lower or an upper limit, or both");
    if (limit.lower && limit.upper && !(*limit.lower < *limit.upper))
      keys.add_problem_at(limit.line, "limit.lower", fmt::format("{} to {}", *limit.lower, *limit.upper),
                          "lower < upper");
    const QuantityRange range = range_of_quantity(limit.quantity, limit.unit);
    for (const auto& [name, bound] : {std::pair("lower", limit.lower), std::pair("upper", limit.upper)})
      if (bound && !(*bound >= range.least && *bound <= range.most))
        keys.add_problem_at(
            limit.line, fmt::format("limit.{}", name),
            fmt::format("{} {} for {}", *bound, limit.unit, limit.quantity),
            fmt::format("a value that the quantity can have, {}", to_string(range, limit.unit)));
    if (rule.kind == DecisionKind::kTestUncertaintyRatio && !(keys.has("lower") && keys.has("upper")))
      keys.add_missing(keys.has("lower") ? "upper" : "lower",
                       "both limits, for rule \"test_uncertainty_ratio\"");
  });
  if (!file.limits.empty() && !file.decision)
    keys.add_problem("decision.rule", "nothing, though limits are given",
                     "one of " + joined(kDecisionRules.all()));
}

void read_scope(TomlReader& keys, std::vector<ScopeLimit>& scope) {
  keys.section("");
  keys.tables("scope", 0, [&](std::size_t) {
    ScopeLimit& limit = scope.emplace_back();
    limit.line = keys.line();
    keys.required_text("quantity", limit.quantity, scope_quantities());
    keys.required_text("unit", limit.unit);
    keys.number("from", limit.from, kNotNegative);
    keys.number("to", limit.to, kNotNegative);
    keys.number("cmc", limit.cmc, kPositive);
    keys.boolean("relative", limit.relative);
    if (!keys.has("cmc")) keys.add_missing("cmc", "the smallest expanded uncertainty, k = 2");
    if (!keys.has("to")) keys.add_missing("to", "the end of the range");
    if (limit.to < limit.from)
      keys.add_problem_at(limit.line, "scope.to", fmt::format("{} to {}", limit.from, limit.to),
                          "from <= to");
  });
}

}  // namespace

std::string format_date(Date date) {
  return fmt::format("{:04}-{:02}-{:02}", static_cast<int>(date.year()), static_cast<unsigned>(date.month()),
                     static_cast<unsigned>(date.day()));
}

std::optional<Date> parse_date(std::string_view text) {
  if (text.size() < 10 || text[4] != '-' || text[7] != '-') return std::nullopt;
  int year = 0;
  unsigned month = 0, day = 0;
  const auto number = [&](std::size_t from, std::size_t length, auto& value) {
    const char* end = text.data() + from + length;
    return std::from_chars(text.data() + from, end, value).ptr == end;
  };
  if (!number(0, 4, year) || !number(5, 2, month) || !number(8, 2, day)) return std::nullopt;
  const Date date{std::chrono::year(year), std::chrono::month(month), std::chrono::day(day)};
  return date.ok() ? std::optional(date) : std::nullopt;
}

const Person* LaboratoryFile::person_who_may(const std::string& right, const std::string& name) const {
  for (const Person& person : persons)
    if (person.name == name && std::find(person.may.begin(), person.may.end(), right) != person.may.end())
      return &person;
  return nullptr;
}

LaboratoryFileError::LaboratoryFileError(const std::string& source, std::vector<Problem> problems)
    : std::invalid_argument([&] {
        std::string text = fmt::format("laboratory file {}: {} problem{}", source, problems.size(),
                                       problems.size() == 1 ? "" : "s");
        text += list_of(problems);
        return text;
      }()),
      problems_(std::move(problems)) {}

ReadLaboratoryFile parse_laboratory_file(std::string_view toml, const std::string& source) {
  ReadLaboratoryFile read;
  LaboratoryFile& file = read.file;
  file.source = source;
  file.text = toml;
  const toml::table root =
      parse_toml(toml, source, "a laboratory file; docs/examples/laboratory.toml is one", read.problems);
  if (root.empty() && !read.problems.empty()) return read;
  TomlReader keys(root, {}, toml);
  std::string schema = "abcal.laboratory/1";
  keys.section("");
  keys.text("schema", schema, {"abcal.laboratory/1"});
  read_laboratory(keys, file.laboratory, file.language);
  read_customer(keys, file.customer);
  read_job(keys, file.job);
  read_persons(keys, file.persons);
  read_equipment(keys, file.equipment);
  read_decision(keys, file);
  read_scope(keys, file.scope);
  keys.section("units");
  keys.texts("sensitivity", file.units);
  keys.report_unknown();
  for (Problem& problem : keys.take_problems()) read.problems.push_back(std::move(problem));
  return read;
}

ReadLaboratoryFile read_laboratory_file(const std::filesystem::path& path) {
  std::vector<Problem> unreadable;
  const std::string text = read_text_file(path.string(), "laboratory file", unreadable);
  if (!unreadable.empty()) {
    ReadLaboratoryFile read;
    read.file.source = path.string();
    read.problems = std::move(unreadable);
    return read;
  }
  return parse_laboratory_file(text, path.string());
}

}  // namespace abcal
