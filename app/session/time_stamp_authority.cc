#include "app/session/time_stamp_authority.h"

#include <fmt/format.h>

#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/url/parse.hpp>
#include <chrono>
#include <cstdlib>
#include <stdexcept>

#include "protocol/record/run_file.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/sha256.h"
#include "protocol/record/time_stamp.h"

namespace abcal {
namespace {

constexpr std::chrono::seconds kPatience{15};

/// Sends a request to an authority (RFC 3161, 3.4) and returns its answer.
/// @throws std::invalid_argument (address), std::runtime_error (no answer)
std::string ask_authority(const std::string& address, const std::string& request) {
  namespace beast = boost::beast;
  namespace http = beast::http;
  const auto url = boost::urls::parse_uri(address);
  if (!url || url->scheme() != "http" || url->host().empty())
    throw std::invalid_argument(fmt::format(
        "authority {}: required: http://HOST[:PORT][/PATH]; for others take --query and --answer", address));
  const std::string host = url->host(), port = url->has_port() ? std::string(url->port()) : "80";
  const std::string target = url->encoded_target().empty() ? "/" : std::string(url->encoded_target());
  boost::asio::io_context context;
  beast::tcp_stream stream(context);
  http::response<http::string_body> answer;
  beast::flat_buffer buffer;
  beast::error_code failure;
  http::request<http::string_body> message(http::verb::post, target, 11, request);
  message.set(http::field::host, host);
  message.set(http::field::content_type, "application/timestamp-query");
  message.prepare_payload();
  boost::asio::ip::tcp::resolver resolver(context);
  // One step after the other, with one deadline for each that goes over the wire.
  const auto then_read = [&](beast::error_code error, std::size_t) {
    failure = error;
    if (!error)
      http::async_read(stream, buffer, answer, [&](beast::error_code read, std::size_t) { failure = read; });
  };
  const auto then_write = [&](beast::error_code error, const auto&) {
    failure = error;
    if (!error) http::async_write(stream, message, then_read);
  };
  stream.expires_after(kPatience);
  const auto found = resolver.resolve(host, port, failure);
  if (!failure) {
    stream.async_connect(found, then_write);
    context.run();
  }
  if (failure)
    throw std::runtime_error(fmt::format("time stamp: {} does not answer: {}", address, failure.message()));
  if (answer.result() != http::status::ok)
    throw std::runtime_error(fmt::format("time stamp: {} answers {}", address, answer.result_int()));
  return answer.body();
}

void require_closed(const std::filesystem::path& run) {
  if (!RunFile::is_closed(run))
    throw std::invalid_argument(run.string() + ": is not closed; only a closed run has a hash to be stamped");
}

}  // namespace

std::string time_stamp_authority(const std::string& given) {
  if (!given.empty()) return given;
  const char* configured = std::getenv("ABCAL_TIME_STAMP_AUTHORITY");
  return configured == nullptr ? std::string() : configured;
}

KeptTimeStamp keep_time_stamp_answer(const std::filesystem::path& run, const std::string& request,
                                     const std::string& answer_der) {
  require_closed(run);
  const std::string sha256 = sha256_of_file(run);
  const TimeStampAnswer answer = read_time_stamp_answer(answer_der, request);
  if (answer.token.empty()) throw std::runtime_error("no time stamp: " + answer.refused);
  const TimeStampCheck stamp = check_time_stamp(answer.token, sha256, {});
  return {stamp.utc, stamp.authority, keep_time_stamp(run, answer.token)};
}

KeptTimeStamp stamp_run(const std::filesystem::path& run, const std::string& address) {
  require_closed(run);
  const std::string request = time_stamp_request(sha256_of_file(run));
  return keep_time_stamp_answer(run, request, ask_authority(address, request));
}

std::optional<std::string> stamp_if_configured(const std::filesystem::path& run) {
  const std::string authority = time_stamp_authority({});
  if (authority.empty() || !read_seal(run).time_stamp.empty()) return std::nullopt;
  try {
    (void)stamp_run(run, authority);
    return std::nullopt;
  } catch (const std::exception& error) {
    return fmt::format(
        "{} has no time stamp yet: {}. It is asked for again by `abcal issue`, or by: abcal lab "
        "timestamp {}",
        run.string(), error.what(), run.string());
  }
}

}  // namespace abcal
