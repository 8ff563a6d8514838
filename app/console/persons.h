#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "drivers/instrument/clock.h"
#include "protocol/record/run_operator.h"

namespace abcal::console {

/// Someone who may use the console.
struct Visitor {
  RunOperator who;          ///< No name: admitted by the token, or as a user of this computer.
  bool may_steer = true;    ///< False: may only watch and press Stop.
  std::string login;        ///< Secret of the login, for the register; empty: no person.
  std::string expires_utc;  ///< End of the login; empty: no person.
};

/// A login that the register does not accept. what() gives the reason.
class LoginRefused : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// Queries of the register. Each opens it, which takes time, and throws LoginRefused, or RegisterError if the
// register cannot be read.
namespace register_of_persons {
/// The person of a login. Steering needs the right to measure.
Visitor look_up(const std::string& location, const std::string& login, Clock::UtcTime now);
Visitor log_in(const std::string& location, const std::string& name, const std::string& password,
               Clock::UtcTime now, std::chrono::minutes validity);
void log_out(const std::string& location, const std::string& login, Clock::UtcTime now);
/// The given logins that the register does not accept any more.
std::vector<std::string> ended(const std::string& location, const std::vector<std::string>& logins,
                               Clock::UtcTime now);
}  // namespace register_of_persons

/// The persons who are logged in, so that the register is not asked for each request; while it cannot be read
/// they stay logged in. For one thread.
class Persons {
 public:
  using Known = std::shared_ptr<const Visitor>;

  /// Null: unknown, or expired.
  Known find(const std::string& login, Clock::UtcTime now);
  Known remember(Visitor person);
  void forget(const std::string& login);
  std::vector<std::string> logins() const;

 private:
  std::map<std::string, Known> known_;  ///< By SHA-256 of the login, so that timing does not reveal it.
};

}  // namespace abcal::console
