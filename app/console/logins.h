#pragma once

#include <boost/asio/thread_pool.hpp>
#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "app/console/http_exchange.h"
#include "app/console/login_throttle.h"
#include "app/console/persons.h"
#include "app/console/server_common.h"

namespace abcal::console {

/// Decides who a visitor is: a person of the register by a login, or a holder of the token. Asks the register
/// in a thread of its own. Its functions are for the thread of the connections.
class Logins {
 public:
  /// @param port  where the console listens: browsers do not keep the cookies of two ports apart
  /// @param ended  called with the logins that may not use the console any more
  Logins(ServerCommon& common, std::uint16_t port,
         std::function<void(const std::vector<std::string>& logins)> ended);
  ~Logins();
  Logins(const Logins&) = delete;
  Logins& operator=(const Logins&) = delete;

  /// Everybody who reaches the console may use it.
  bool is_open() const;
  /// Whether an undeclared proxy has passed the request on to a console that is open to everybody.
  bool is_proxied_unknown(const HttpRequest& request) const;

  /// The login that a request shows; empty: none.
  std::string login_of(const HttpRequest& request) const;
  /// The remembered person of a login; null: none.
  Persons::Known find(const std::string& login);
  /// Asks the register about a login that is not known here. @param then  called with null if nobody has it
  void look_up(const std::string& login, const Peer& peer, std::function<void(const Persons::Known&)> then);

  /// The answer to a visitor who is not identified.
  HttpResponse ask_who(const Asked& asked, const std::string& path);
  /// POST /login: a form with `token`, or with `name` and `password`.
  HttpResponse log_in(const Asked& asked, Slow& later);
  /// POST /logout: ends the login, its pages and its cookies.
  HttpResponse log_out(const Asked& asked);
  /// To be called each second: ends logins that have expired, and every 30 s those that the register ended.
  /// @param of_pages  the logins of the pages that are open
  void check(const std::vector<std::string>& of_pages);

  /// How long an attempt has to wait after too many failures; zero: it may be made. To be asked where the
  /// password is tried, one attempt after another, so that parallel attempts do not evade the limit. This and
  /// the next two functions may be called from any thread.
  Clock::Duration wait(const std::string& name, const Peer& peer) const;
  void failed(const std::string& name, const Peer& peer);
  void succeeded(const std::string& name, const Peer& peer);
  /// The answer to an attempt that has to wait.
  HttpResponse refuse_throttled(const Asked& asked, Clock::Duration wait);

 private:
  HttpResponse log_in_by_token(const Asked& asked, const std::string& token);
  HttpResponse greet(const Asked& asked, const std::string& cookie, const std::string& value,
                     std::chrono::seconds life) const;
  void set_cookie(const Asked& asked, HttpResponse& response, const std::string& name,
                  const std::string& value, std::chrono::seconds life) const;
  void end(const std::vector<std::string>& logins);

  ServerCommon& common_;
  const std::string login_cookie_;
  const std::function<void(const std::vector<std::string>&)> ended_;
  Persons persons_;
  LoginThrottle throttle_;
  Clock::Instant checked_{};          ///< When the register was last asked which logins it ended.
  bool checks_ = false;               ///< The register is being asked.
  boost::asio::thread_pool door_{1};  ///< Thread that asks the register.
};

}  // namespace abcal::console
