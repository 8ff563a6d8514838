// abcal-transfer: the client of abcal for HTTP and mail, so that no start of abcal loads libcurl.
//   abcal-transfer
//     sends one message of a run (app/measure/session/notifier.h). Descriptor 3 is one end of a socket: the
//     message is read from it, and "sent" or the reason of a failure is written to it.
//   abcal-transfer time-stamp ADDRESS REQUEST ANSWER
//     sends the file REQUEST to a time-stamp authority and writes its answer into the file ANSWER
//     (app/witness/time_stamp_authority.h).
//   abcal-transfer --version
#include <curl/curl.h>
#include <fmt/format.h>

#include <array>
#include <csignal>
#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "app/system/channel.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/system/version.h"

namespace {

using Json = nlohmann::json;
using List = std::unique_ptr<curl_slist, void (*)(curl_slist*)>;

/// Longest time until a message is sent, and of its connecting.
constexpr long kMessageSeconds = 10, kConnectSeconds = 5;
/// Longest time until a time-stamp authority has answered, its connecting included.
constexpr long kTimeStampSeconds = 15;
/// An answer of an authority has some kilobytes; a longer one than this is not read to its end.
constexpr std::size_t kLargestAnswer = 1U << 20U;

std::string environment(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

/// One line of a header: line breaks, which would begin another one, become blanks.
std::string one_line(std::string text) {
  for (char& c : text)
    if (c == '\n' || c == '\r') c = ' ';
  return text;
}

/// One request of libcurl.
class Transfer {
 public:
  Transfer(const char* protocols, const std::string& address, long longest_s)
      : curl_(curl_easy_init(), curl_easy_cleanup) {
    if (!curl_) throw std::runtime_error("libcurl cannot be used");
    set(CURLOPT_PROTOCOLS_STR, protocols);
    set(CURLOPT_URL, address.c_str());
    set(CURLOPT_TIMEOUT, longest_s);
    set(CURLOPT_NOSIGNAL, 1L);
    set(CURLOPT_WRITEDATA, &answer_);
    set(CURLOPT_WRITEFUNCTION, keep);
  }
  Transfer(const Transfer&) = delete;
  Transfer& operator=(const Transfer&) = delete;

  template <class Value>
  void set(CURLoption option, Value value) {
    if (const CURLcode code = curl_easy_setopt(curl_.get(), option, value); code != CURLE_OK)
      throw std::runtime_error(curl_easy_strerror(code));
  }
  /// Sends bytes by HTTP POST. They and the headers must outlive the request.
  void set_post(const std::string& body, const List& headers) {
    set(CURLOPT_HTTPHEADER, headers.get());
    set(CURLOPT_POSTFIELDSIZE_LARGE, static_cast<curl_off_t>(body.size()));
    set(CURLOPT_POSTFIELDS, body.data());
  }
  /// @return the status of the server's answer
  /// @throws std::runtime_error if the server does not answer, with curl's message
  long perform() {
    if (const CURLcode code = curl_easy_perform(curl_.get()); code != CURLE_OK)
      throw std::runtime_error(curl_easy_strerror(code));
    long status = 0;
    curl_easy_getinfo(curl_.get(), CURLINFO_RESPONSE_CODE, &status);
    return status;
  }
  CURL* handle() { return curl_.get(); }
  const std::string& answer() const { return answer_; }

 private:
  static std::size_t keep(char* bytes, std::size_t size, std::size_t count, void* answer) {
    auto& kept = *static_cast<std::string*>(answer);
    if (kept.size() + size * count > kLargestAnswer) return 0;  // libcurl ends the transfer.
    kept.append(bytes, size * count);
    return size * count;
  }

  std::string answer_;
  std::unique_ptr<CURL, void (*)(CURL*)> curl_;
};

/// @throws std::runtime_error where the message is not accepted
void deliver(Transfer& message, const std::string& recipient) {
  long status = 0;
  try {
    status = message.perform();
  } catch (const std::exception& error) {
    throw std::runtime_error(fmt::format("{}: {}", recipient, error.what()));
  }
  if (status >= 300)
    throw std::runtime_error(fmt::format("{} answers {}; required: 200 to 299", recipient, status));
}

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
  // An address may hold a secret, so messages show only the bench file's own words.
  const std::string body = message.dump();
  const List headers = list_of({"Content-Type: application/json", "User-Agent: abcal"});
  Transfer transfer("http,https", address, kMessageSeconds);
  transfer.set(CURLOPT_CONNECTTIMEOUT, kConnectSeconds);
  transfer.set_post(body, headers);
  deliver(transfer, is_named ? configured : "the webhook");
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
  Transfer transfer("smtp,smtps", server, kMessageSeconds);
  const std::unique_ptr<curl_mime, void (*)(curl_mime*)> parts(curl_mime_init(transfer.handle()),
                                                               curl_mime_free);
  curl_mimepart* part = curl_mime_addpart(parts.get());
  curl_mime_data(part, text.c_str(), text.size());
  curl_mime_type(part, "text/plain; charset=utf-8");
  curl_mime_encoder(part, "quoted-printable");
  transfer.set(CURLOPT_CONNECTTIMEOUT, kConnectSeconds);
  transfer.set(CURLOPT_USE_SSL, static_cast<long>(user.empty() ? CURLUSESSL_TRY : CURLUSESSL_ALL));
  if (!user.empty()) {
    transfer.set(CURLOPT_USERNAME, user.c_str());
    transfer.set(CURLOPT_PASSWORD, password.c_str());
  }
  transfer.set(CURLOPT_MAIL_FROM, from.c_str());
  transfer.set(CURLOPT_MAIL_RCPT, recipients.get());
  transfer.set(CURLOPT_HTTPHEADER, headers.get());
  transfer.set(CURLOPT_MIMEPOST, parts.get());
  deliver(transfer, server);
}

/// @return "sent", or every reason of a failure
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

/// Sends the message that arrives at the socket. @return exit code
int answer_socket() {
  constexpr int kSocket = 3;
  constexpr std::size_t kLongest = 64 * 1024;
  std::string words;
  try {
    const auto packet = abcal::receive_packet(kSocket, kLongest);
    if (!packet) return abcal::kExitFailed;
    words = send_all(Json::parse(packet->bytes));
  } catch (const std::exception& error) {
    words = error.what();
  }
  const bool is_heard = abcal::send_packet(kSocket, words);
  if (words == "sent") return abcal::kExitDone;
  if (!is_heard)
    abcal::print_log("abcal-transfer: a message to those in [notify] did not arrive: {}\n", words);
  return abcal::kExitFailed;
}

/// @throws std::invalid_argument unless the address is one of HTTP, which authorities use: a time stamp is
/// signed, and the stamped hash is not a secret
void require_http(const std::string& address) {
  const std::unique_ptr<CURLU, void (*)(CURLU*)> url(curl_url(), curl_url_cleanup);
  char* text = nullptr;
  const bool is_address = url && curl_url_set(url.get(), CURLUPART_URL, address.c_str(), 0) == CURLUE_OK &&
                          curl_url_get(url.get(), CURLUPART_SCHEME, &text, 0) == CURLUE_OK;
  const std::unique_ptr<char, void (*)(void*)> scheme(text, curl_free);
  if (!is_address || std::string_view(scheme.get()) != "http")
    throw std::invalid_argument(fmt::format(
        "authority {}: required: http://HOST[:PORT][/PATH]; for others take --query and --answer", address));
}

/// Sends a request to a time-stamp authority (RFC 3161, 3.4). @return its answer
/// @throws std::invalid_argument (address), std::runtime_error (no answer)
std::string ask_authority(const std::string& address, const std::string& request) {
  require_http(address);
  const List headers = list_of({"Content-Type: application/timestamp-query", "User-Agent: abcal"});
  Transfer transfer("http", address, kTimeStampSeconds);
  transfer.set_post(request, headers);
  long status = 0;
  try {
    status = transfer.perform();
  } catch (const std::exception& error) {
    throw std::runtime_error(fmt::format("time stamp: {} does not answer: {}", address, error.what()));
  }
  constexpr long kOk = 200;
  if (status != kOk) throw std::runtime_error(fmt::format("time stamp: {} answers {}", address, status));
  return transfer.answer();
}

}  // namespace

int main(int argc, char** argv) {
  std::signal(SIGPIPE, SIG_IGN);
  const std::vector<std::string> words(argv + 1, argv + argc);
  if (words.empty()) return answer_socket();
  try {
    if (words == std::vector<std::string>{"--version"}) {
      abcal::print_result("abcal-transfer {}\n", abcal::program_version());
    } else if (words.size() == 4 && words[0] == "time-stamp") {
      abcal::OutputFile(words[3]).write(ask_authority(words[1], abcal::read_file(words[2])));
    } else {
      throw std::invalid_argument("required: time-stamp ADDRESS REQUEST ANSWER");
    }
    return abcal::finish_output(abcal::kExitDone);
  } catch (const std::invalid_argument& error) {
    abcal::print_error(error.what());
    return abcal::kExitUsage;
  } catch (const std::exception& error) {
    abcal::print_error(error.what());
    return abcal::kExitFailed;
  }
}
