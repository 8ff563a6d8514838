// abcal-notify: sends one message of a run by HTTP and mail (app/session/notifier.h). Started by abcal, with
// one end of a socket as descriptor 3: the message comes from there, "sent" or the reason goes there.
#include <curl/curl.h>
#include <fmt/format.h>
#include <sys/socket.h>

#include <array>
#include <csignal>
#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "app/system/output.h"

namespace {

using Json = nlohmann::json;
using List = std::unique_ptr<curl_slist, void (*)(curl_slist*)>;

constexpr long kConnectSeconds = 5, kWholeSeconds = 10;

std::string environment(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

/// One line of a header: nothing in it begins another one.
std::string one_line(std::string text) {
  for (char& c : text)
    if (c == '\n' || c == '\r') c = ' ';
  return text;
}

/// @throws std::runtime_error with curl's words, or the status that the server answers
class Transfer {
 public:
  Transfer() : curl_(curl_easy_init(), curl_easy_cleanup) {
    if (!curl_) throw std::runtime_error("libcurl cannot be used");
    set(CURLOPT_CONNECTTIMEOUT, kConnectSeconds);
    set(CURLOPT_TIMEOUT, kWholeSeconds);
    set(CURLOPT_NOSIGNAL, 1L);
    set(
        CURLOPT_WRITEFUNCTION,
        +[](char*, std::size_t size, std::size_t count, void*) { return size * count; });
  }
  template <class Value>
  void set(CURLoption option, Value value) {
    if (const CURLcode code = curl_easy_setopt(curl_.get(), option, value); code != CURLE_OK)
      throw std::runtime_error(curl_easy_strerror(code));
  }
  void carry_out(const std::string& whom) {
    if (const CURLcode code = curl_easy_perform(curl_.get()); code != CURLE_OK)
      throw std::runtime_error(fmt::format("{}: {}", whom, curl_easy_strerror(code)));
    long status = 0;
    curl_easy_getinfo(curl_.get(), CURLINFO_RESPONSE_CODE, &status);
    if (status >= 300)
      throw std::runtime_error(fmt::format("{} answers {}; required: 200 to 299", whom, status));
  }
  CURL* handle() { return curl_.get(); }

 private:
  std::unique_ptr<CURL, void (*)(CURL*)> curl_;
};

List list_of(const std::vector<std::string>& lines) {
  List list(nullptr, curl_slist_free_all);
  for (const std::string& line : lines) {
    curl_slist* longer = curl_slist_append(list.get(), line.c_str());
    if (longer == nullptr) throw std::bad_alloc();
    (void)list.release();
    list.reset(longer);
  }
  return list;
}

void post(const std::string& configured, const Json& message) {
  constexpr std::string_view kFromEnvironment = "env:";
  const bool is_named = configured.starts_with(kFromEnvironment);
  const std::string name = is_named ? configured.substr(kFromEnvironment.size()) : "";
  const std::string address = is_named ? environment(name.c_str()) : configured;
  if (address.empty())
    throw std::runtime_error(fmt::format("the environment variable {} of [notify] webhook is not set", name));
  // An address may hold a secret: only the bench file's own words are told.
  const std::string body = message.dump();
  const List headers = list_of({"Content-Type: application/json", "User-Agent: abcal"});
  Transfer transfer;
  transfer.set(CURLOPT_PROTOCOLS_STR, "http,https");
  transfer.set(CURLOPT_URL, address.c_str());
  transfer.set(CURLOPT_HTTPHEADER, headers.get());
  transfer.set(CURLOPT_POSTFIELDS, body.c_str());
  transfer.carry_out(is_named ? configured : "the webhook");
}

void mail(const Json& packet) {
  const Json& message = packet.at("message");
  const std::string to = one_line(packet.at("mail_to")), from = one_line(packet.at("mail_from"));
  const auto words = [&](const char* key) { return message.at(key).get<std::string>(); };
  const List headers =
      list_of({"To: " + to, "From: " + from,
               one_line(fmt::format("Subject: abcal {}{}: {}", words("bench"),
                                    message.at("simulated") == true ? " (simulated)" : "", words("event")))});
  const List recipients = list_of({to});
  std::string text = words("text") + "\r\n\r\n";
  for (const char* key : {"run", "item", "operator", "utc"})
    text += fmt::format("{}: {}\r\n", key, words(key));
  const std::string user = environment("ABCAL_MAIL_USER"), password = environment("ABCAL_MAIL_PASSWORD");
  const std::string server = packet.at("mail_server");
  Transfer transfer;
  const std::unique_ptr<curl_mime, void (*)(curl_mime*)> parts(curl_mime_init(transfer.handle()),
                                                               curl_mime_free);
  curl_mimepart* part = curl_mime_addpart(parts.get());
  curl_mime_data(part, text.c_str(), text.size());
  curl_mime_type(part, "text/plain; charset=utf-8");
  curl_mime_encoder(part, "quoted-printable");
  transfer.set(CURLOPT_PROTOCOLS_STR, "smtp,smtps");
  transfer.set(CURLOPT_URL, server.c_str());
  transfer.set(CURLOPT_USE_SSL, static_cast<long>(user.empty() ? CURLUSESSL_TRY : CURLUSESSL_ALL));
  if (!user.empty()) {
    transfer.set(CURLOPT_USERNAME, user.c_str());
    transfer.set(CURLOPT_PASSWORD, password.c_str());
  }
  transfer.set(CURLOPT_MAIL_FROM, from.c_str());
  transfer.set(CURLOPT_MAIL_RCPT, recipients.get());
  transfer.set(CURLOPT_HTTPHEADER, headers.get());
  transfer.set(CURLOPT_MIMEPOST, parts.get());
  transfer.carry_out(server);
}

/// @return "sent", or every reason why not
std::string send_all(const Json& packet) {
  std::string failures;
  const auto attempt = [&](auto&& send) {
    try {
      send();
    } catch (const std::exception& error) {
      failures += (failures.empty() ? "" : "; ") + std::string(error.what());
    }
  };
  if (const std::string webhook = packet.at("webhook"); !webhook.empty())
    attempt([&] { post(webhook, packet.at("message")); });
  if (packet.at("mail_to") != "") attempt([&] { mail(packet); });
  return failures.empty() ? "sent" : failures;
}

}  // namespace

int main() {
  std::signal(SIGPIPE, SIG_IGN);
  constexpr int kSocket = 3;
  constexpr std::size_t kLongest = 64 * 1024;
  std::string words;
  try {
    std::vector<char> packet(kLongest);
    const ssize_t count = ::recv(kSocket, packet.data(), packet.size(), 0);
    if (count <= 0) return 1;
    words = send_all(Json::parse(packet.begin(), packet.begin() + count));
  } catch (const std::exception& error) {
    words = error.what();
  }
  const bool is_heard = ::send(kSocket, words.data(), words.size(), MSG_NOSIGNAL) >= 0;
  if (words == "sent") return 0;
  if (!is_heard) abcal::print_log("abcal-notify: a message to those in [notify] did not arrive: {}\n", words);
  return 1;
}
