#include "app/console/http_exchange.h"

#include <fmt/format.h>

#include <chrono>
#include <nlohmann/json.hpp>
#include <utility>

#include "app/console/asset.h"
#include "app/console/visible_text.h"
#include "app/document/json_text.h"
#include "app/system/output.h"
#include "drivers/wire/readable_bytes.h"
#include "protocol/record/message_json.h"

namespace abcal::console {
namespace {

namespace http = boost::beast::http;

std::string answer_text(const nlohmann::ordered_json& body) {
  return with_visible_direction_controls(json_text(body));
}

std::string_view content_type(std::string_view path) {
  if (path.ends_with(".html")) return "text/html; charset=utf-8";
  if (path.ends_with(".css")) return "text/css; charset=utf-8";
  if (path.ends_with(".js")) return "text/javascript; charset=utf-8";
  if (path.ends_with(".svg")) return "image/svg+xml";
  return "application/octet-stream";
}

}  // namespace

void RefusalLog::operator()(const Peer& peer, std::string_view what, std::string_view why) {
  constexpr int kMost = 50;
  constexpr Clock::Duration kWhile = std::chrono::seconds(10);
  constexpr std::size_t kShown = 200;
  const Clock::Instant now = clock_.now();
  if (now - since_ > kWhile) {
    if (count_ > kMost) print_warning(fmt::format("console: {} more were refused", count_ - kMost));
    since_ = now;
    count_ = 0;
  }
  if (++count_ > kMost) return;
  print_warning(fmt::format("console: refused from {}: {}: {}", peer.remote,
                            wire::bytes_as_text(what.substr(0, kShown)), why));
}

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

HttpResponse plain(const HttpRequest& request, http::status status, std::string text) {
  return respond(request, status, "text/plain; charset=utf-8", std::move(text) + "\n");
}

HttpResponse refuse(RefusalLog& log, const Asked& asked, http::status status, const Message& why) {
  const std::string_view target = view(asked.request.target());
  log(asked.peer,
      fmt::format("{} {}", view(asked.request.method_string()), target.substr(0, target.find('?'))),
      why.english());
  HttpResponse response = plain(asked.request, status, why);
  // Headers are ASCII.
  if (!why.id().empty())
    response.set("Abcal-Message",
                 message_json(why).dump(-1, ' ', true, nlohmann::json::error_handler_t::replace));
  return response;
}

HttpResponse json_answer(const HttpRequest& to, const nlohmann::ordered_json& body) {
  return respond(to, http::status::ok, "application/json", answer_text(body));
}

std::shared_ptr<const Product> made_of_json(const nlohmann::ordered_json& body) {
  return std::make_shared<const Product>(Product{200, "application/json", answer_text(body)});
}

std::optional<HttpResponse> answer_with_asset(const HttpRequest& request, std::string_view path,
                                              http::status status) {
  for (const Asset& asset : assets())
    if (asset.path == path) return respond(request, status, content_type(path), std::string(asset.body));
  return std::nullopt;
}

HttpRequest head_of(const HttpRequest& request) {
  HttpRequest head;
  head.version(request.version());
  head.keep_alive(request.keep_alive());
  return head;
}

boost::asio::ip::address plain_ip(boost::asio::ip::address address) {
  if (address.is_v6() && address.to_v6().is_v4_mapped())
    return boost::asio::ip::make_address_v4(boost::asio::ip::v4_mapped, address.to_v6());
  return address;
}

std::string host_of(const boost::asio::ip::address& address) {
  return address.is_v6() ? "[" + address.to_string() + "]" : address.to_string();
}

}  // namespace abcal::console
