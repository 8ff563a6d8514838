#include <fmt/format.h>

#include "app/laboratory/register/register.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal::lab {
namespace {

constexpr const char* kPersonColumns = "name, role, email, rights, valid_from, valid_to";

std::string joined(const std::vector<Right>& rights) {
  std::string words;
  for (const Right right : rights) words.append(words.empty() ? "" : ", ").append(to_string(right));
  return words;
}

std::vector<Right> split(const std::string& words) {
  std::vector<Right> rights;
  std::size_t at = 0;
  while (at < words.size()) {
    std::size_t end = words.find(", ", at);
    if (end == std::string::npos) end = words.size();
    if (const auto right = right_from(words.substr(at, end - at))) rights.push_back(*right);
    at = end + 2;
  }
  return rights;
}

Person person_of(const Database::Row& row) {
  return {row[0], row[1], row[2], split(row[3]), row[4], row[5]};
}

}  // namespace

void Register::add_person(const LoggedIn& by, const Person& person, const std::string& password,
                          Clock::UtcTime now, PasswordCost cost) {
  require(by, Right::kAdminister);
  if (person.name.empty() || person.role.empty()) throw RegisterError("a person needs a name and a role");
  if (const std::string why = password.empty() ? "" : weakness_of(password); !why.empty())
    throw RegisterError("the password of " + person.name + ": " + why);
  const std::string hash =
      count_time_of([&] { return password.empty() ? std::string() : hash_password(password, cost); });
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_new("person", person.name);
  change({by.name(), "person added", "person", person.name, {}}, now, [&] {
    database_.insert("person", {{"name", person.name},
                                {"role", person.role},
                                {"email", person.email},
                                {"rights", joined(person.rights)},
                                {"password", hash},
                                {"valid_from", person.valid_from.empty() ? format_utc(now).substr(0, 10)
                                                                         : person.valid_from},
                                {"valid_to", ""}});
  });
  transaction.commit();
}

void Register::set_password(const LoggedIn& by, const std::string& name, const std::string& password,
                            Clock::UtcTime now, PasswordCost cost) {
  if (by.name() != name) require(by, Right::kAdminister);
  if (const std::string why = weakness_of(password); !why.empty())
    throw RegisterError("the password of " + name + ": " + why);
  const std::string hash = count_time_of([&] { return hash_password(password, cost); });
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_known("person", name);
  change({by.name(), "password set", "person", name, {}}, now, [&] {
    database_.execute("update person set password = :password where name = :name",
                      {{"password", hash}, {"name", name}});
    database_.execute("delete from login where person = :name", {{"name", name}});
  });
  transaction.commit();
}

void Register::retire_person(const LoggedIn& by, const std::string& name, const std::string& reason,
                             Clock::UtcTime now) {
  require(by, Right::kAdminister);
  if (reason.empty()) throw RegisterError("retiring " + name + ": no reason is given");
  DatabaseTransaction transaction(database_);
  lock_audit();
  require_known("person", name);
  bool another = false;
  for (const Person& person : persons())
    another = another || (person.name != name && person.valid_to.empty() && person.may(Right::kAdminister));
  if (!another) throw RegisterError(name + " is the only administrator and cannot be retired");
  change({by.name(), "person retired", "person", name, reason}, now, [&] {
    database_.execute("update person set valid_to = :to where name = :name",
                      {{"to", format_utc(now).substr(0, 10)}, {"name", name}});
    database_.execute("delete from login where person = :name", {{"name", name}});
  });
  transaction.commit();
}

std::vector<Person> Register::persons() {
  std::vector<Person> persons;
  for (const auto& row :
       database_.query(6, fmt::format("select {} from person order by name", kPersonColumns)))
    persons.push_back(person_of(row));
  return persons;
}

std::optional<Person> Register::find_person(const std::string& name) {
  const auto rows = database_.query(
      6, fmt::format("select {} from person where name = :name", kPersonColumns), {{"name", name}});
  if (rows.empty()) return std::nullopt;
  return person_of(rows[0]);
}

std::string Register::log_in(const std::string& name, const std::string& password, Clock::UtcTime now,
                             std::chrono::minutes validity) {
  const auto stored =
      database_.query(2, "select password, valid_to from person where name = :name", {{"name", name}});
  // The refusal takes as long for an unknown name as for a person, so that the time does not reveal the names
  // in the register.
  const bool is_person = !stored.empty() && stored[0][1].empty();
  const bool fits =
      count_time_of([&] { return is_password(password, is_person ? stored[0][0] : hash_of_no_password()); });
  if (!is_person || !fits) {
    if (!stored.empty()) change_alone({name, "login refused", "person", name, {}}, now, [] {});
    throw RegisterError(
        fmt::format("login of {}: refused; required: a person of this register with this password", name));
  }
  const std::string token = random_token();
  DatabaseTransaction transaction(database_);
  lock_audit();
  database_.execute("delete from login where expires_utc < :now", {{"now", format_utc(now)}});
  change({name, "logged in", "person", name, {}}, now, [&] {
    database_.insert("login", {{"token_hash", sha256_of(token)},
                               {"person", name},
                               {"created_utc", format_utc(now)},
                               {"expires_utc", format_utc(now + validity)}});
  });
  transaction.commit();
  return token;
}

void Register::log_out(const std::string& token, Clock::UtcTime now) {
  const LoggedIn person = who(token, now);
  change_alone({person.name(), "logged out", "person", person.name(), {}}, now, [&] {
    database_.execute("delete from login where token_hash = :hash", {{"hash", sha256_of(token)}});
  });
}

LoggedIn Register::who(const std::string& token, Clock::UtcTime now) {
  const auto rows = database_.query(2, "select person, expires_utc from login where token_hash = :hash",
                                    {{"hash", sha256_of(token)}});
  if (rows.empty())
    throw RegisterError("the login is not known to the register; log in with `abcal lab login`");
  if (rows[0][1] <= format_utc(now))
    throw RegisterError(fmt::format("the login of {} ended at {}; log in again with `abcal lab login`",
                                    rows[0][0], rows[0][1]));
  const auto person = find_person(rows[0][0]);
  if (!person || !person->valid_to.empty())
    throw RegisterError(fmt::format("{} is no longer a person of this register", rows[0][0]));
  return {*person, facts_.identity, rows[0][1]};
}

}  // namespace abcal::lab
