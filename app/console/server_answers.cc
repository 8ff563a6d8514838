#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <charconv>
#include <cmath>
#include <utility>

#include "app/bench/bench_config.h"
#include "app/console/asset.h"
#include "app/console/download.h"
#include "app/console/server_impl.h"
#include "app/console/start_form.h"
#include "app/console/visible_text.h"
#include "app/results/tray_results.h"
#include "app/system/output.h"
#include "protocol/record/run_file.h"

namespace abcal::console {
namespace {

namespace http = boost::beast::http;

std::string_view content_type(std::string_view path) {
  if (path.ends_with(".html")) return "text/html; charset=utf-8";
  if (path.ends_with(".css")) return "text/css; charset=utf-8";
  if (path.ends_with(".js")) return "text/javascript; charset=utf-8";
  if (path.ends_with(".svg")) return "image/svg+xml";
  return "application/octet-stream";
}

/// The number of an item; nothing: it is none.
std::optional<int> item_of(const std::string& text) {
  int item = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), item);
  if (error != std::errc() || end != text.data() + text.size() || item < 1 ||
      item > static_cast<int>(kMostItems))
    return std::nullopt;
  return item;
}

const Asset* find_asset(std::string_view path) {
  for (const Asset& asset : assets())
    if (asset.path == path) return &asset;
  return nullptr;
}

/// What the page that asks who somebody is needs itself.
bool is_for_everybody(std::string_view path) {
  return path == "/login.js" || path == "/language.js" || path == "/de.js" || path == "/style.css" ||
         path == "/favicon-idle.svg";
}

std::string answer_text(const nlohmann::ordered_json& body) {
  return with_visible_direction_controls(
      body.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
}

}  // namespace

HttpResponse respond(const HttpRequest& request, http::status status, std::string_view type,
                     std::string body) {
  HttpResponse response(status, request.version());
  response.set(http::field::server, "abcal");
  response.set(http::field::content_type, {type.data(), type.size()});
  response.set(http::field::cache_control, "no-store");
  response.set("Content-Security-Policy",
               "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
               "form-action 'self'; base-uri 'none'; frame-ancestors 'none'");
  response.set("X-Content-Type-Options", "nosniff");
  response.set("X-Frame-Options", "DENY");
  response.set("Referrer-Policy", "no-referrer");
  response.set("Cross-Origin-Opener-Policy", "same-origin");
  response.set("Cross-Origin-Resource-Policy", "same-origin");
  response.keep_alive(request.keep_alive());
  response.body() = std::move(body);
  response.prepare_payload();
  return response;
}

HttpResponse json_answer(const HttpRequest& to, const nlohmann::ordered_json& body) {
  return respond(to, http::status::ok, "application/json", answer_text(body));
}

std::shared_ptr<const Product> made_of_json(const nlohmann::ordered_json& body) {
  return std::make_shared<const Product>(Product{200, "application/json", answer_text(body)});
}

HttpResponse plain(const HttpRequest& request, http::status status, std::string text) {
  return respond(request, status, "text/plain; charset=utf-8", std::move(text) + "\n");
}

HttpRequest head_of(const HttpRequest& request) {
  HttpRequest head;
  head.version(request.version());
  head.keep_alive(request.keep_alive());
  return head;
}

HttpResponse Server::Impl::refuse(const Asked& asked, http::status status, const std::string& why) {
  // Without what stands behind "?", which may be a secret.
  const std::string_view target = view(asked.request.target());
  log_refusal(asked.peer,
              fmt::format("{} {}", view(asked.request.method_string()), target.substr(0, target.find('?'))),
              why);
  return plain(asked.request, status, why);
}

bool Server::Impl::is_proxied_unknown(const HttpRequest& request) const {
  return is_open() && (request.count("Forwarded") + request.count("X-Forwarded-For") +
                       request.count("X-Real-IP") + request.count("Via")) > 0;
}

/// The answer to a request. `later` is set if the answer takes long.
HttpResponse Server::Impl::answer(const Asked& asked, Slow& later) {
  const HttpRequest& request = asked.request;
  if (asked.access == Access::kWrongHost)
    return refuse(asked, http::status::misdirected_request,
                  "This console is not known by that name; see `abcal serve --host`.");
  if (asked.access == Access::kWrongOrigin)
    return refuse(asked, http::status::forbidden, "Another page may not use this console.");
  if (is_proxied_unknown(request))
    return refuse(
        asked, http::status::forbidden,
        "This came through a proxy, but this console is for this computer's accounts alone; see `abcal "
        "serve --trusted-proxy`.");
  const std::optional<Target> target = parse_target(view(request.target()));
  if (!target) return refuse(asked, http::status::bad_request, "The path cannot be read.");
  const std::string& path = target->path;
  const bool reads = request.method() == http::verb::get || request.method() == http::verb::head;
  if (path == "/login" && request.method() == http::verb::post && !is_open()) return log_in(asked, later);
  if (asked.access == Access::kNoToken) return ask_who(asked, path);
  if (path == "/logout" && request.method() == http::verb::post) return log_out(asked);
  if (path == "/approve" && request.method() == http::verb::post) return approve_certificate(asked, later);
  if (is_signed_certificate(request)) return take_signed_certificate(asked, target->words, later);
  if (!reads) return refuse(asked, http::status::method_not_allowed, "Only GET is answered here.");

  if (const Asset* asset = find_asset(path == "/" ? "/index.html" : path))
    return respond(request, http::status::ok, content_type(asset->path), std::string(asset->body));
  if (path == "/who") {
    const Visitor& visitor = asked.visitor;
    return json_answer(request, {{"person", visitor.who.name}, {"may_steer", visitor.may_steer}});
  }
  if (path == "/start-form") {
    if (order_start_form(asked, later)) return {};
    return refuse(asked, http::status::bad_request, "The fields of the form cannot be read.");
  }
  if (order_of_library(target->words, later) || order_approval(target->words, asked.visitor, later)) {
    later.head = head_of(request);
    return {};
  }
  later = {};  // Of what was not found nothing is made.
  return refuse(asked, http::status::not_found, "There is no such page.");
}

/// GET /start-form?steps=...&serial_number=...: what would be started. @return false: the fields cannot be
/// read
bool Server::Impl::order_start_form(const Asked& asked, Slow& later) {
  const std::string_view target = view(asked.request.target());
  const std::size_t query = target.find('?');
  const auto fields =
      parse_form(query == std::string_view::npos ? std::string_view() : target.substr(query + 1));
  if (!fields) return false;
  later.head = head_of(asked.request);
  later.workshop = &analyses;
  later.make = [this, fields = *fields, who = asked.visitor.who](const std::stop_token&) {
    const StartFormAsked form{bench_file, runs, options.register_location, who, parse_run_choice(fields)};
    return made_of_json(start_form(form, library, clock.utc_now()));
  };
  return true;
}

// ---- Who it is

HttpResponse Server::Impl::ask_who(const Asked& asked, const std::string& path) {
  const bool persons_asked = options.access.persons;
  if (is_for_everybody(path)) {
    const Asset* asset = find_asset(path);
    return respond(asked.request, http::status::ok, content_type(path), std::string(asset->body));
  }
  log_refusal(asked.peer, path, persons_asked ? "nobody is logged in" : "no token");
  if (path == "/") {
    const Asset* asset = find_asset(persons_asked ? "/person.html" : "/token.html");
    return respond(asked.request, http::status::unauthorized, content_type(asset->path),
                   std::string(asset->body));
  }
  return plain(asked.request, http::status::unauthorized,
               persons_asked ? "Log in first." : "A token is required.");
}

std::string Server::Impl::login_of(const HttpRequest& request) const {
  if (!options.access.persons) return {};
  std::string_view login = cookie_value(view(request[http::field::cookie]), login_cookie);
  if (login.empty()) login = bearer_of(view(request[http::field::authorization]));
  // A login has as many letters as random_token() makes; the token may stand there as well.
  constexpr std::size_t kLogin = 64;
  if (login.size() != kLogin) return {};
  if (!options.access.token.empty() && same_secret(login, options.access.token)) return {};
  return std::string(login);
}

void Server::Impl::set_cookie(const Asked& asked, HttpResponse& response, const std::string& name,
                              const std::string& value, std::chrono::seconds life) const {
  // A browser that speaks TLS to a proxy says so in its origin, which is known to be ours.
  const bool secure = asked.peer.secure || view(asked.request[http::field::origin]).starts_with("https://");
  response.insert(http::field::set_cookie,
                  fmt::format("{}={}; HttpOnly; SameSite=Strict; Path=/; Max-Age={}{}", name, value,
                              life.count(), secure ? "; Secure" : ""));
}

HttpResponse Server::Impl::too_many_failures(const Asked& asked, Clock::Duration wait) {
  const auto seconds = static_cast<long>(std::ceil(to_seconds(wait)));
  HttpResponse response =
      refuse(asked, http::status::too_many_requests,
             fmt::format("Too many attempts have failed; the next is possible in {} s.", seconds));
  response.set(http::field::retry_after, fmt::format("{}", seconds));
  return response;
}

HttpResponse Server::Impl::log_in_by_token(const Asked& asked, const std::string& token) {
  const std::string& client = asked.peer.client;
  if (const auto wait = throttle.wait({}, client, clock.now()); wait > Clock::Duration::zero())
    return too_many_failures(asked, wait);
  if (options.access.token.empty() || !same_secret(token, options.access.token)) {
    throttle.failed({}, client, clock.now());
    return refuse(asked, http::status::unauthorized, "This is not the token.");
  }
  throttle.succeeded({}, client);
  constexpr std::chrono::hours kTokenLife{24 * 30};
  HttpResponse response = plain(asked.request, http::status::see_other, "Welcome.");
  response.set(http::field::location, "/");
  set_cookie(asked, response, options.access.cookie, options.access.token, kTokenLife);
  return response;
}

/// POST /login: a form with `token`, or with `name` and `password`.
HttpResponse Server::Impl::log_in(const Asked& asked, Slow& later) {
  const auto form = parse_form(asked.request.body());
  if (!form) return refuse(asked, http::status::bad_request, "The form cannot be read.");
  const auto field = [&](const char* name) { return field_of(*form, name); };
  if (form->contains("token")) return log_in_by_token(asked, field("token"));
  const std::string name = field("name"), password = field("password");
  if (!options.access.persons || name.empty())
    return refuse(asked, http::status::bad_request, "The form lacks a name and a password, or a token.");
  if (const auto wait = throttle.wait(name, asked.peer.client, clock.now()); wait > Clock::Duration::zero())
    return too_many_failures(asked, wait);

  // The request is gone when the register has answered.
  struct Attempt {
    Peer peer;
    HttpRequest head;
    std::string name;
    std::optional<Visitor> person;
    std::string refusal, problem;
  };
  auto attempt = std::make_shared<Attempt>(Attempt{asked.peer, head_of(asked.request), name, {}, {}, {}});
  attempt->head.target("/login");
  attempt->head.method(http::verb::post);
  attempt->head.set(http::field::origin, asked.request[http::field::origin]);
  const auto finish = [this, attempt]() -> HttpResponse {
    const Asked then{attempt->peer, attempt->head, Access::kNoToken, {}};
    const std::string& client = attempt->peer.client;
    if (!attempt->problem.empty())
      return refuse(then, http::status::service_unavailable,
                    "The register cannot be read: " + attempt->problem);
    // Those who failed meanwhile count: many attempts at once are no way around.
    if (const auto wait = throttle.wait(attempt->name, client, clock.now()); wait > Clock::Duration::zero())
      return too_many_failures(then, wait);
    if (!attempt->person) {
      throttle.failed(attempt->name, client, clock.now());
      return refuse(then, http::status::unauthorized, "Name or password is not right.");
    }
    throttle.succeeded(attempt->name, client);
    const Persons::Known person = persons.remember(*std::move(attempt->person));
    print_log("console: {} has logged in from {}\n", person->who.name, attempt->peer.remote);
    HttpResponse response = plain(attempt->head, http::status::see_other, "Welcome.");
    response.set(http::field::location, "/");
    set_cookie(then, response, login_cookie, person->login, options.login_time);
    return response;
  };
  later.where = &door;
  later.job = [this, attempt, password, finish] {
    try {
      attempt->person = register_of_persons::log_in(options.register_location, attempt->name, password,
                                                    clock.utc_now(), options.login_time);
    } catch (const LoginRefused& error) {
      attempt->refusal = error.what();
    } catch (const std::exception& error) {
      attempt->problem = error.what();
    }
    return Slow::Finish(finish);
  };
  return {};
}

/// POST /logout: ends the login, its pages and its cookies.
HttpResponse Server::Impl::log_out(const Asked& asked) {
  if (const std::string login = asked.visitor.login; !login.empty()) {
    end_logins({login});
    boost::asio::post(door, [this, login] {
      try {
        register_of_persons::log_out(options.register_location, login, clock.utc_now());
      } catch (const std::exception& error) {
        print_warning(fmt::format("console: logging out: {}", error.what()));
      }
    });
  }
  HttpResponse response = plain(asked.request, http::status::see_other, "Good-bye.");
  response.set(http::field::location, "/");
  set_cookie(asked, response, login_cookie, "", std::chrono::seconds(0));
  set_cookie(asked, response, options.access.cookie, "", std::chrono::seconds(0));
  return response;
}

/// These persons may not use the console any more.
void Server::Impl::end_logins(const std::vector<std::string>& logins) {
  std::vector<std::shared_ptr<Page>> theirs;
  for (const std::string& login : logins) {
    persons.forget(login);
    for (const std::shared_ptr<Page>& page : pages)
      if (page->visitor().login == login) theirs.push_back(page);
  }
  for (const std::shared_ptr<Page>& page : theirs) page->close();
}

/// Each second: logins that have expired; each half minute also those that the register ended.
void Server::Impl::look_at_logins() {
  if (!options.access.persons) return;
  const Clock::UtcTime now = clock.utc_now();
  std::vector<std::string> expired;
  for (const std::shared_ptr<Page>& page : pages)
    if (!page->visitor().login.empty() && !persons.find(page->visitor().login, now))
      expired.push_back(page->visitor().login);
  end_logins(expired);
  constexpr Clock::Duration kAskAgain = std::chrono::seconds(30);
  const std::vector<std::string> logins = persons.logins();
  if (looks_at_logins || logins.empty() || clock.now() - looked_at_logins < kAskAgain) return;
  looks_at_logins = true;
  looked_at_logins = clock.now();
  boost::asio::post(door, [this, logins, now] {
    std::vector<std::string> over;
    try {
      over = register_of_persons::ended(options.register_location, logins, now);
    } catch (const std::exception& lost) {
      // A register that cannot be read ends nothing: who is there goes on, and may stop what moves.
      print_warning(fmt::format("console: the register cannot be read: {}", lost.what()));
    }
    boost::asio::post(io, [this, over] {
      looks_at_logins = false;
      end_logins(over);
    });
  });
}

std::shared_ptr<void> Server::Impl::take_seat(const std::string& address) {
  if (seats >= options.most_connections) return nullptr;
  std::size_t& of_address = seats_of[address];
  if (of_address >= options.most_of_address) return nullptr;
  ++seats;
  ++of_address;
  return {this, [address](Impl* impl) {
            --impl->seats;
            if (--impl->seats_of[address] == 0) impl->seats_of.erase(address);
          }};
}

// ---- Runs

Workshop::Make Server::Impl::kept(const std::string& what, std::vector<std::filesystem::path> files,
                                  std::function<Product(const std::stop_token&)> make) {
  return [this, what, files = std::move(files), make = std::move(make)](const std::stop_token& cancelled) {
    const std::string key = products.key_of(what, files);
    if (!key.empty())
      if (std::shared_ptr<const Product> known = products.find(key)) return known;
    auto product = std::make_shared<const Product>(make(cancelled));
    // Of files that have not changed meanwhile.
    if (!key.empty() && products.key_of(what, files) == key) products.keep(key, product);
    return product;
  };
}

/// /runs, /runs/NAME/result, /runs/NAME/DOWNLOAD, /runs/NAME/items/K/result and so on,
/// /compare/NAME/NAME[/shared-stage], /history/SERIAL/PROPERTY
bool Server::Impl::order_of_library(const std::vector<std::string>& words, Slow& later) {
  later.workshop = &analyses;
  if (words == std::vector<std::string>{"runs"}) {
    later.workshop = &lists;
    later.make = [this](const std::stop_token&) { return made_of_json(library.list()); };
    return true;
  }
  if (words.size() == 3 && words[0] == "history") {
    if (!RunLibrary::is_charted(words[2])) return false;
    later.make = [this, serial = words[1], property = words[2]](const std::stop_token&) {
      return made_of_json(library.history(serial, property));
    };
    return true;
  }
  later.name = fmt::format("{}", fmt::join(words, "/"));
  const bool shared_stage = words.size() == 4 && words[3] == "shared-stage";
  if ((words.size() == 3 || shared_stage) && words[0] == "compare") {
    const auto first = library.find(words[1]), second = library.find(words[2]);
    if (!first || !second) return false;
    later.make = kept(shared_stage ? "compare, shared stage" : "compare", {*first, *second},
                      [first = *first, second = *second, shared_stage](const std::stop_token&) {
                        return *made_of_json(RunLibrary::compare(first, second, shared_stage));
                      });
    return true;
  }
  const auto of = find_item(words);
  return of && order_of_run(*of, words.back(), later);
}

std::optional<ItemOfRun> Server::Impl::find_item(const std::string& run, const std::string& item) const {
  const auto path = library.find(run);
  const auto number = item.empty() ? 0 : item_of(item);
  if (!path || !number) return std::nullopt;
  return ItemOfRun{*path, *number};
}

std::optional<ItemOfRun> Server::Impl::find_item(const std::vector<std::string>& words) const {
  const bool of_item = words.size() == 5 && words[2] == "items";
  if ((words.size() != 3 && !of_item) || words[0] != "runs") return std::nullopt;
  if (of_item && words[3].empty()) return std::nullopt;
  return find_item(words[1], of_item ? words[3] : "");
}

/// What is made of a run, of one of its items; item 0 is the first that was not left out.
bool Server::Impl::order_of_run(const ItemOfRun& of, const std::string& what, Slow& later) {
  const std::vector<std::filesystem::path> files{of.run, ResultsFile::path_beside(of.run)};
  const std::string of_item = of.item == 0 ? "" : fmt::format(", item {}", of.item);
  if (what == "result") {
    later.make = kept("result" + of_item, files, [this, of](const std::stop_token&) {
      return *made_of_json(library.result(of.run, of.item));
    });
    return true;
  }
  for (const Download& download : downloads()) {
    if (what != download.name) continue;
    if (download.is_printed) later.workshop = &prints;
    later.make = kept(download.name + of_item, files, [of, download](const std::stop_token& cancelled) {
      const int item = of.item == 0 ? first_whole_item(RunFile::load(of.run)) : of.item;
      return Product{200, download.content_type, download.make({of.run, item}, cancelled), true};
    });
    return true;
  }
  return false;
}

}  // namespace abcal::console
