#include "app/console/logins.h"

#include <fmt/format.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <cmath>
#include <memory>
#include <string_view>
#include <utility>

#include "app/console/access.h"
#include "app/console/target.h"
#include "app/system/output.h"

namespace abcal::console {
namespace {

namespace http = boost::beast::http;

/// Whether the login page itself needs this file.
bool is_for_everybody(std::string_view path) {
  return path == "/login.js" || path == "/language.js" || path == "/de.js" || path == "/style.css" ||
         path == "/favicon-idle.svg";
}

}  // namespace

Logins::Logins(ServerCommon& common, std::uint16_t port,
               std::function<void(const std::vector<std::string>&)> ended)
    : common_(common), login_cookie_(fmt::format("abcal_login_{}", port)), ended_(std::move(ended)) {
  common.options.access.cookie = fmt::format("abcal_token_{}", port);
}

Logins::~Logins() {
  door_.stop();
  door_.join();
}

bool Logins::is_open() const {
  return common_.options.access.token.empty() && !common_.options.access.persons;
}

bool Logins::is_proxied_unknown(const HttpRequest& request) const {
  return is_open() && (request.count("Forwarded") + request.count("X-Forwarded-For") +
                       request.count("X-Real-IP") + request.count("Via")) > 0;
}

std::string Logins::login_of(const HttpRequest& request) const {
  const AccessRules& access = common_.options.access;
  if (!access.persons) return {};
  std::string_view login = cookie_value(view(request[http::field::cookie]), login_cookie_);
  if (login.empty()) login = bearer_of(view(request[http::field::authorization]));
  // A login has the length that random_token() makes; the header may also contain the access token.
  constexpr std::size_t kLogin = 64;
  if (login.size() != kLogin) return {};
  if (!access.token.empty() && same_secret(login, access.token)) return {};
  return std::string(login);
}

Persons::Known Logins::find(const std::string& login) {
  return persons_.find(login, common_.clock.utc_now());
}

void Logins::look_up(const std::string& login, const Peer& peer,
                     std::function<void(const Persons::Known&)> then) {
  boost::asio::post(door_, [this, login, peer, then = std::move(then)]() mutable {
    std::optional<Visitor> person;
    std::string problem;
    try {
      person =
          register_of_persons::look_up(common_.options.register_location, login, common_.clock.utc_now());
    } catch (const std::exception& error) {
      problem = error.what();
    }
    // Moved, so that the captures of `then` are destroyed in the thread of the connections.
    boost::asio::post(common_.io,
                      [this, peer, person = std::move(person), problem, then = std::move(then)]() mutable {
                        if (!person) common_.log_refusal(peer, "a login", problem);
                        then(person ? persons_.remember(*std::move(person)) : nullptr);
                      });
  });
}

HttpResponse Logins::ask_who(const Asked& asked, const std::string& path) {
  const bool persons_asked = common_.options.access.persons;
  if (is_for_everybody(path)) return *answer_with_asset(asked.request, path);
  common_.log_refusal(asked.peer, path, persons_asked ? "nobody is logged in" : "no token");
  if (path == "/")
    return *answer_with_asset(asked.request, persons_asked ? "/person.html" : "/token.html",
                              http::status::unauthorized);
  return plain(asked.request, http::status::unauthorized,
               persons_asked ? "Log in first." : "A token is required.");
}

void Logins::set_cookie(const Asked& asked, HttpResponse& response, const std::string& name,
                        const std::string& value, std::chrono::seconds life) const {
  // The origin shows whether the browser speaks TLS to a proxy; it is known to be ours.
  const bool secure = asked.peer.secure || view(asked.request[http::field::origin]).starts_with("https://");
  response.insert(http::field::set_cookie,
                  fmt::format("{}={}; HttpOnly; SameSite=Strict; Path=/; Max-Age={}{}", name, value,
                              life.count(), secure ? "; Secure" : ""));
}

/// Redirects to the page, with the cookie that grants access.
HttpResponse Logins::greet(const Asked& asked, const std::string& cookie, const std::string& value,
                           std::chrono::seconds life) const {
  HttpResponse response = plain(asked.request, http::status::see_other, "Welcome.");
  response.set(http::field::location, "/");
  set_cookie(asked, response, cookie, value, life);
  return response;
}

Clock::Duration Logins::wait(const std::string& name, const Peer& peer) const {
  return std::max(throttle_.wait(name, peer.client, common_.clock.now()), Clock::Duration::zero());
}

HttpResponse Logins::refuse_throttled(const Asked& asked, Clock::Duration wait) {
  const auto seconds = static_cast<long>(std::ceil(to_seconds(wait)));
  HttpResponse response =
      refuse(common_.log_refusal, asked, http::status::too_many_requests,
             Message("Too many attempts have failed; the next is possible in {seconds} s.", seconds));
  response.set(http::field::retry_after, fmt::format("{}", seconds));
  return response;
}

void Logins::failed(const std::string& name, const Peer& peer) {
  throttle_.failed(name, peer.client, common_.clock.now());
}

void Logins::succeeded(const std::string& name, const Peer& peer) {
  throttle_.succeeded(name, peer.client);
}

HttpResponse Logins::log_in_by_token(const Asked& asked, const std::string& token) {
  const AccessRules& access = common_.options.access;
  if (const auto time = wait({}, asked.peer); time > Clock::Duration::zero())
    return refuse_throttled(asked, time);
  if (access.token.empty() || !same_secret(token, access.token)) {
    failed({}, asked.peer);
    return refuse(common_.log_refusal, asked, http::status::unauthorized, Message("This is not the token."));
  }
  succeeded({}, asked.peer);
  constexpr std::chrono::hours kTokenLife{24 * 30};
  return greet(asked, access.cookie, access.token, kTokenLife);
}

HttpResponse Logins::log_in(const Asked& asked, Slow& later) {
  const auto form = parse_form(asked.request.body());
  if (!form)
    return refuse(common_.log_refusal, asked, http::status::bad_request, Message("The form cannot be read."));
  const auto field = [&](const char* name) { return field_of(*form, name); };
  if (form->contains("token")) return log_in_by_token(asked, field("token"));
  const std::string name = field("name"), password = field("password");
  if (!common_.options.access.persons || name.empty())
    return refuse(common_.log_refusal, asked, http::status::bad_request,
                  Message("The form lacks a name and a password, or a token."));
  // The request is gone when the register has answered.
  struct Attempt {
    Peer peer;
    HttpRequest head;
    std::string name;
    Clock::Duration wait{};
    std::optional<Visitor> person;
    std::string problem;
  };
  auto attempt = std::make_shared<Attempt>(Attempt{asked.peer, head_of(asked.request), name, {}, {}, {}});
  attempt->head.target("/login");
  attempt->head.method(http::verb::post);
  attempt->head.set(http::field::origin, asked.request[http::field::origin]);
  const auto finish = [this, attempt]() -> HttpResponse {
    const Asked then{attempt->peer, attempt->head, Access::kNoToken, {}};
    if (!attempt->problem.empty())
      return refuse(common_.log_refusal, then, http::status::service_unavailable,
                    Message("The register cannot be read: {why}", attempt->problem));
    if (attempt->wait > Clock::Duration::zero()) return refuse_throttled(then, attempt->wait);
    if (!attempt->person)
      return refuse(common_.log_refusal, then, http::status::unauthorized,
                    Message("Name or password is not right."));
    const Persons::Known person = persons_.remember(*std::move(attempt->person));
    print_log("console: {} has logged in from {}\n", person->who.name, attempt->peer.remote);
    return greet(then, login_cookie_, person->login, common_.options.login_time);
  };
  later.where = &door_;
  later.job = [this, attempt, password, finish] {
    attempt->wait = wait(attempt->name, attempt->peer);
    if (attempt->wait > Clock::Duration::zero()) return Slow::Finish(finish);
    try {
      attempt->person =
          register_of_persons::log_in(common_.options.register_location, attempt->name, password,
                                      common_.clock.utc_now(), common_.options.login_time);
      succeeded(attempt->name, attempt->peer);
    } catch (const LoginRefused&) {  // No person: the attempt has failed.
      failed(attempt->name, attempt->peer);
    } catch (const std::exception& error) {
      attempt->problem = error.what();
    }
    return Slow::Finish(finish);
  };
  return {};
}

HttpResponse Logins::log_out(const Asked& asked) {
  if (const std::string login = asked.visitor.login; !login.empty()) {
    end({login});
    boost::asio::post(door_, [this, login] {
      try {
        register_of_persons::log_out(common_.options.register_location, login, common_.clock.utc_now());
      } catch (const std::exception& error) {
        print_warning(fmt::format("console: logging out: {}", error.what()));
      }
    });
  }
  HttpResponse response = plain(asked.request, http::status::see_other, "Good-bye.");
  response.set(http::field::location, "/");
  set_cookie(asked, response, login_cookie_, "", std::chrono::seconds(0));
  set_cookie(asked, response, common_.options.access.cookie, "", std::chrono::seconds(0));
  return response;
}

/// Ends logins: forgets them, and closes their pages.
void Logins::end(const std::vector<std::string>& logins) {
  for (const std::string& login : logins) persons_.forget(login);
  if (!logins.empty()) ended_(logins);
}

void Logins::check(const std::vector<std::string>& of_pages) {
  if (!common_.options.access.persons) return;
  const Clock::UtcTime now = common_.clock.utc_now();
  std::vector<std::string> expired;
  for (const std::string& login : of_pages)
    if (!persons_.find(login, now)) expired.push_back(login);
  end(expired);
  constexpr Clock::Duration kAskAgain = std::chrono::seconds(30);
  const std::vector<std::string> logins = persons_.logins();
  if (checks_ || logins.empty() || common_.clock.now() - checked_ < kAskAgain) return;
  checks_ = true;
  checked_ = common_.clock.now();
  boost::asio::post(door_, [this, logins, now] {
    std::vector<std::string> over;
    try {
      over = register_of_persons::ended(common_.options.register_location, logins, now);
    } catch (const std::exception& lost) {
      // A register that cannot be read does not end a login: persons continue, and may stop the stage.
      print_warning(fmt::format("console: the register cannot be read: {}", lost.what()));
    }
    boost::asio::post(common_.io, [this, over] {
      checks_ = false;
      end(over);
    });
  });
}

}  // namespace abcal::console
