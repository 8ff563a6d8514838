#include "app/console/server.h"

#include <fmt/format.h>
#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <boost/asio/post.hpp>
#include <stdexcept>
#include <utility>

#include "app/console/bench_service.h"
#include "app/console/forwarded.h"
#include "app/console/server_impl.h"
#include "app/system/output.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal::console {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
using asio::ip::tcp;
using Json = nlohmann::ordered_json;

constexpr std::chrono::seconds kBeat{1};
/// After this time without an answer to a beat nothing is known of the other end.
constexpr std::chrono::seconds kSilent{3};

SharedText shared(std::string text) {
  return std::make_shared<const std::string>(std::move(text));
}

/// The id of a request, which may be refused for something else; 0: it has none that could be one.
std::uint64_t stated_id(std::string_view text) {
  const Json object = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!object.is_object() || !object.contains("id") || !object["id"].is_number_unsigned()) return 0;
  return object["id"].get<std::uint64_t>();
}

/// Whoever may reach a console from elsewhere says who it is, and nobody listens.
void require_protection(const ServerOptions& options, const asio::ip::address& address) {
  const bool open = options.access.token.empty() && options.register_location.empty();
  if (!address.is_loopback() && !options.tls)
    throw std::invalid_argument(fmt::format(
        "the console does not listen on {} without TLS: whoever listens on the network could read passwords "
        "and steer; required: a TLS certificate, or an address of this computer alone (127.0.0.1)",
        options.address));
  if (!address.is_loopback() && open)
    throw std::invalid_argument(fmt::format(
        "the console does not listen on {} for everybody; required: a token or a register", options.address));
  if (open && (!options.access.hosts.empty() || !options.trusted_proxies.empty()))
    throw std::invalid_argument(
        "the console is not opened to everybody who reaches a proxy; required: a token or a register");
}

asio::ssl::context tls_context(const TlsIdentity& identity) {
  asio::ssl::context context(asio::ssl::context::tls_server);
  context.set_options(asio::ssl::context::default_workarounds | asio::ssl::context::no_tlsv1 |
                      asio::ssl::context::no_tlsv1_1);
  context.use_certificate_chain(asio::buffer(identity.certificate_pem));
  context.use_private_key(asio::buffer(identity.key_pem), asio::ssl::context::pem);
  return context;
}

}  // namespace

asio::ip::address plain_ip(asio::ip::address address) {
  if (address.is_v6() && address.to_v6().is_v4_mapped())
    return asio::ip::make_address_v4(asio::ip::v4_mapped, address.to_v6());
  return address;
}

std::string host_of(const asio::ip::address& address) {
  return address.is_v6() ? "[" + address.to_string() + "]" : address.to_string();
}

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

Server::Impl::Impl(ServerOptions the_options, Session::Options bench_options)
    : options(std::move(the_options)),
      bench_file(bench_options.bench_file),
      runs(bench_options.runs),
      library(bench_options.runs),
      silent(options.silent) {
  options.access.persons = !options.register_location.empty();
  require_protection(options, asio::ip::make_address(options.address));
  if (options.tls) tls.emplace(tls_context(*options.tls));
  listen();
  const auto port = acceptor.local_endpoint().port();
  options.access.cookie = fmt::format("abcal_token_{}", port);
  login_cookie = fmt::format("abcal_login_{}", port);
  make_bench_link(std::move(bench_options));
  accept();
  look_around();
  bench->begin();
  thread = std::jthread([this] { io.run(); });
}

void Server::Impl::listen() {
  try {
    const tcp::endpoint endpoint(asio::ip::make_address(options.address), options.port);
    acceptor.open(endpoint.protocol());
    acceptor.set_option(asio::socket_base::reuse_address(true));
    acceptor.bind(endpoint);
    acceptor.listen();
  } catch (const boost::system::system_error& error) {
    throw std::runtime_error(fmt::format("the console cannot listen on {}, port {}: {}", options.address,
                                         options.port, error.code().message()));
  }
}

void Server::Impl::make_bench_link(Session::Options bench_options) {
  BenchLink::Listener listener;
  listener.message = [this](std::string_view json) { broadcast(shared(std::string(json))); };
  listener.snapshot = [this](std::string_view json) { have_snapshot(json); };
  listener.reply = [this](const Json& reply) { answered(reply); };
  listener.state = [this](BenchState state, const std::string& words) { bench_is(state, words); };
  listener.end = [this](bool was_on) {
    if (!std::exchange(bench_is_closed, true)) bench_closed.set_value(was_on);
  };
  const bool is_service = !options.bench_socket.empty();
  const std::filesystem::path socket =
      is_service ? options.bench_socket : default_bench_socket(bench_options);
  bench = std::make_unique<BenchLink>(io, BenchLink::Options{std::move(bench_options), socket, !is_service},
                                      std::move(listener));
}

Server::Impl::~Impl() {
  io.stop();
  thread = {};
  for (Workshop* workshop : {&lists, &analyses, &prints}) workshop->close();
  door.stop();
  door.join();
  seal.join();  // A certificate that was begun is issued.
  controller = nullptr;
  pages.clear();
}

void Server::Impl::accept() {
  acceptor.async_accept([this](beast::error_code error, tcp::socket socket) {
    if (error == asio::error::operation_aborted) return;
    if (error) {
      // No descriptors left, most likely: they come back.
      accept_again.expires_after(std::chrono::milliseconds(100));
      accept_again.async_wait([this](beast::error_code cancelled) {
        if (!cancelled) accept();
      });
      return;
    }
    std::make_shared<HttpConnection>(*this, std::move(socket))->begin();
    accept();
  });
}

/// Each second: whether the page that steers still answers the beats, and whose login has ended.
void Server::Impl::look_around() {
  next_look.expires_after(kBeat);
  next_look.async_wait([this](beast::error_code cancelled) {
    if (cancelled) return;
    const bool is_silent = controller != nullptr && clock.now() - controller->heard > kSilent;
    if (std::exchange(controller_silent, is_silent) != is_silent) broadcast(shared(control_message()));
    look_at_logins();
    look_around();
  });
}

void Server::Impl::broadcast(const SharedText& text) {
  for (const std::shared_ptr<Page>& page : pages)
    if (!page->waits_for_snapshot) page->send(text);
}

void Server::Impl::have_snapshot(std::string_view json) {
  const SharedText text = shared(std::string(json));
  const SharedText control = shared(control_message());
  for (const std::shared_ptr<Page>& page : pages) {
    if (!std::exchange(page->waits_for_snapshot, false)) continue;
    page->send(text);
    page->send(control);
  }
}

std::string Server::Impl::bench_message() const {
  return Json{{"type", "bench"}, {"state", to_string(bench_state)}, {"words", bench_words}}.dump();
}

/// The process that holds the bench has come or gone.
void Server::Impl::bench_is(BenchState state, const std::string& words) {
  bench_state = state;
  bench_words = words;
  const SharedText text = shared(bench_message());
  for (const std::shared_ptr<Page>& page : pages) page->send(text);
  if (state == BenchState::kGone) {
    for (const auto& [number, request] : std::exchange(passed_on, {})) {
      if (const std::shared_ptr<Page> page = request.page.lock())
        page->reply(Json{{"type", "reply"}, {"id", request.id}, {"ok", false}, {"lost", true}, {"why", words}}
                        .dump());
    }
  }
  if (state != BenchState::kOn) return;
  for (const std::shared_ptr<Page>& page : pages) page->waits_for_snapshot = true;
  bench->ask_snapshot();
}

void Server::Impl::arrived(const std::shared_ptr<Page>& page) {
  page->number = ++pages_so_far;
  page->heard = clock.now();
  pages.insert(page);
  const Visitor& visitor = page->visitor();
  page->send(shared(Json{{"type", "you"},
                         {"number", page->number},
                         {"person", visitor.who.name},
                         {"may_steer", visitor.may_steer}}
                        .dump(-1, ' ', false, Json::error_handler_t::replace)));
  if (bench_state != BenchState::kOn) page->send(shared(bench_message()));
  send_snapshot(*page);
}

/// The whole state, for a page that begins or has missed messages.
void Server::Impl::send_snapshot(Page& page) {
  const bool is_asked =
      std::any_of(pages.begin(), pages.end(), [](const auto& other) { return other->waits_for_snapshot; });
  page.waits_for_snapshot = true;
  if (!is_asked) bench->ask_snapshot();
}

std::string Server::Impl::control_message() const {
  Json message = {{"type", "control"}, {"page", nullptr}};
  if (controller != nullptr) {
    message["page"] = controller->number;
    message["who"] = controller->asker().for_people();
    message["silent"] = controller_silent;
  }
  return message.dump();
}

void Server::Impl::left(Page& page) {
  if (controller == &page) give_control(nullptr);
  pages.erase(page.shared_from_this());
}

void Server::Impl::give_control(Page* page) {
  controller = page;
  controller_silent = false;
  broadcast(shared(control_message()));
}

void Server::Impl::received(Page& page, std::string_view text) {
  Json reply = {{"type", "reply"}, {"id", stated_id(text)}, {"ok", false}};
  page.heard = clock.now();
  try {
    const Request request = parse_request(text);
    if (std::holds_alternative<Beat>(request.command)) return;
    reply["id"] = request.id;
    Session::Refusal refusal;
    if (const auto* take = std::get_if<TakeControl>(&request.command)) {
      refusal = take_control(page, *take);
    } else if (controller != &page && !std::holds_alternative<Stop>(request.command)) {
      // Who sees that something goes wrong stops it, with control or without.
      refusal = "this page only watches; take control first";
    } else if (std::holds_alternative<ReleaseControl>(request.command)) {
      give_control(nullptr);
    } else if (!bench->is_on()) {
      refusal = "the process that holds the bench is not there";
    } else {
      passed_on[++passed_on_so_far] = {page.weak_from_this(), request.id, std::string(text)};
      return bench->request(passed_on_so_far, page.asker(), text);
    }
    if (refusal) throw RequestError(*refusal);
    reply["ok"] = true;
  } catch (const RequestError& error) {
    log_refusal(page.peer(), text, error.what());
    reply["why"] = error.what();
  }
  page.reply(reply.dump(-1, ' ', false, Json::error_handler_t::replace));
}

/// The bench has answered a request that was passed on.
void Server::Impl::answered(const Json& reply) {
  const auto found = passed_on.find(reply.at("id").get<std::uint64_t>());
  if (found == passed_on.end()) return;
  const PassedOn request = std::move(found->second);
  passed_on.erase(found);
  const std::shared_ptr<Page> page = request.page.lock();
  if (!page) return;
  Json message = {{"type", "reply"}, {"id", request.id}, {"ok", reply.at("ok")}};
  if (!reply.at("ok").get<bool>()) {
    message["why"] = reply.at("why");
    log_refusal(page->peer(), request.text, reply.at("why").get<std::string>());
  }
  page->reply(message.dump(-1, ' ', false, Json::error_handler_t::replace));
}

Session::Refusal Server::Impl::take_control(Page& page, const TakeControl& take) {
  if (!page.visitor().may_steer)
    return fmt::format("{} may watch and stop, but not steer; required: a person with the right to measure",
                       page.visitor().who.name.empty() ? "who has the token" : page.visitor().who.name);
  if (controller != nullptr && controller != &page && !take.from_another)
    return fmt::format("{} steers; take control from it first", controller->asker().for_people());
  if (controller != &page) bench->control_taken(page.asker());
  give_control(&page);
  return std::nullopt;
}

/// In the thread of whoever serves: ends the bench, or leaves it alone. @return whether something was on
bool Server::Impl::end(bool leave_running) {
  asio::post(io, [this, leave_running] {
    if (leave_running) bench->leave();
    const bool waits = !leave_running && bench->close_bench();
    if (!waits && !std::exchange(bench_is_closed, true)) bench_closed.set_value(false);
  });
  // The longest halt that a driver waits for, twice.
  constexpr std::chrono::seconds kLongestEnd{60};
  std::future<bool> closed = bench_closed.get_future();
  if (closed.wait_for(kLongestEnd) == std::future_status::ready) return closed.get();
  print_error(
      "the process that holds the bench does not answer: the stage may be moving, stop it by its own switch");
  return true;
}

Server::Server(ServerOptions options, Session::Options bench)
    : impl_(std::make_unique<Impl>(std::move(options), std::move(bench))) {}

Server::~Server() = default;

std::uint16_t Server::port() const {
  return impl_->acceptor.local_endpoint().port();
}

bool Server::serve(const std::stop_token& stop, const std::function<bool()>& leaves_bench) {
  std::promise<void> stopped;
  {
    const std::stop_callback on_stop(stop, [&stopped] { stopped.set_value(); });
    stopped.get_future().wait();
  }
  // The pages still see how it ends.
  return impl_->end(!impl_->options.bench_socket.empty() || (leaves_bench && leaves_bench()));
}

}  // namespace abcal::console
