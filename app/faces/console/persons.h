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
  RunOperator who;          ///< No name: nobody said; the token or this computer's accounts let them in.
  bool may_steer = true;    ///< Else watches, and may press Stop.
  std::string login;        ///< Of a person: what proves it to the register.
  std::string expires_utc;  ///< Of a person: the end of the login.
};

/// A login that the register does not accept. what() says why.
class LoginRefused : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// The register itself: each opens it, which takes its time, and throws LoginRefused, or RegisterError where
// it cannot be read.
namespace register_of_persons {
/// Who a login is of. Steering needs the right to measure.
Visitor look_up(const std::string& location, const std::string& login, Clock::UtcTime now);
Visitor log_in(const std::string& location, const std::string& name, const std::string& password,
               Clock::UtcTime now, std::chrono::minutes validity);
void log_out(const std::string& location, const std::string& login, Clock::UtcTime now);
/// Those of these logins that the register does not accept any more.
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
  std::map<std::string, Known> known_;  ///< By the login's SHA-256: its letters decide on no time.
};

}  // namespace abcal::console
