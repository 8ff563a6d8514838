#include "app/console/persons.h"

#include <algorithm>
#include <utility>

#include "app/laboratory/register/register.h"
#include "protocol/record/run_file.h"
#include "protocol/record/sha256.h"

namespace abcal::console {
namespace {

/// Most logins that are remembered; beyond it the register is asked again.
constexpr std::size_t kMostPersons = 500;

/// Reports a refusal. If the register is lost instead, the next query throws its own exception.
[[noreturn]] void refuse(lab::Register& opened, const lab::RegisterError& error) {
  (void)opened.find_person({});
  throw LoginRefused(error.what());
}

Visitor visitor_of(lab::Register& opened, const std::string& login, Clock::UtcTime now) {
  try {
    const lab::LoggedIn person = opened.who(login, now);
    return {{person.name(), person.register_identity()},
            person.person().may(lab::Right::kMeasure),
            login,
            person.expires_utc()};
  } catch (const lab::RegisterError& error) {
    refuse(opened, error);
  }
}

}  // namespace

namespace register_of_persons {

Visitor look_up(const std::string& location, const std::string& login, Clock::UtcTime now) {
  lab::Register opened = lab::Register::open(location, now);
  return visitor_of(opened, login, now);
}

Visitor log_in(const std::string& location, const std::string& name, const std::string& password,
               Clock::UtcTime now, std::chrono::minutes validity) {
  lab::Register opened = lab::Register::open(location, now);
  std::string login;
  try {
    login = opened.log_in(name, password, now, validity);
  } catch (const lab::RegisterError& error) {
    refuse(opened, error);
  }
  return visitor_of(opened, login, now);
}

void log_out(const std::string& location, const std::string& login, Clock::UtcTime now) {
  lab::Register::open(location, now).log_out(login, now);
}

std::vector<std::string> ended(const std::string& location, const std::vector<std::string>& logins,
                               Clock::UtcTime now) {
  lab::Register opened = lab::Register::open(location, now);
  std::vector<std::string> over;
  for (const std::string& login : logins) {
    try {
      (void)visitor_of(opened, login, now);
    } catch (const LoginRefused&) {
      over.push_back(login);
    }
  }
  return over;
}

}  // namespace register_of_persons

Persons::Known Persons::find(const std::string& login, Clock::UtcTime now) {
  const auto found = known_.find(sha256_of(login));
  if (found == known_.end()) return nullptr;
  if (found->second->expires_utc > format_utc(now)) return found->second;
  known_.erase(found);
  return nullptr;
}

Persons::Known Persons::remember(Visitor person) {
  if (known_.size() >= kMostPersons)
    known_.erase(std::min_element(known_.begin(), known_.end(), [](const auto& a, const auto& b) {
      return a.second->expires_utc < b.second->expires_utc;
    }));
  const std::string key = sha256_of(person.login);
  return known_[key] = std::make_shared<const Visitor>(std::move(person));
}

void Persons::forget(const std::string& login) {
  known_.erase(sha256_of(login));
}

std::vector<std::string> Persons::logins() const {
  std::vector<std::string> logins;
  for (const auto& [key, person] : known_) logins.push_back(person->login);
  return logins;
}

}  // namespace abcal::console
