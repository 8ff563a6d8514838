// TLS of the console: its certificate, and that everything goes through it.

#include "app/console/tls.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <boost/asio/ssl.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/ssl.hpp>

#include "app/system/real_clock.h"
#include "tests/console/console_fixture.h"

namespace abcal::console {
namespace {

namespace asio = boost::asio;
namespace http = boost::beast::http;
using testing::HasSubstr;

const Clock::UtcTime kNow = RealClock().utc_now();

class TlsTest : public ConsoleTest {
 protected:
  std::string refusal(const std::filesystem::path& certificate, const std::filesystem::path& key) {
    try {
      (void)read_tls_identity(certificate, key);
      return "read";
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
  }
  std::filesystem::path private_file(const char* name, const std::string& text) {
    test::write_file(folder / name, text);
    ::chmod((folder / name).c_str(), 0600);
    return folder / name;
  }
};

TEST_F(TlsTest, TheCertificateIsKeptAsLongAsItServes) {
  const TlsIdentity first = own_tls_identity(folder.path(), {"bench.example.org", "192.0.2.1"}, kNow);
  EXPECT_TRUE(first.self_signed);
  EXPECT_EQ(tls_fingerprint(first).size(), 95U);
  struct stat facts {};
  ASSERT_EQ(::stat((folder / "console-tls.pem").c_str(), &facts), 0);
  EXPECT_EQ(facts.st_mode & 0777U, 0600U);
  const std::string print = tls_fingerprint(first);
  EXPECT_EQ(tls_fingerprint(own_tls_identity(folder.path(), {"192.0.2.1"}, kNow)), print);
  EXPECT_NE(tls_fingerprint(own_tls_identity(folder.path(), {"other.example.org"}, kNow)), print);
  const std::string second = tls_fingerprint(own_tls_identity(folder.path(), {"other.example.org"}, kNow));
  EXPECT_NE(tls_fingerprint(
                own_tls_identity(folder.path(), {"other.example.org"}, kNow + std::chrono::hours(24 * 730))),
            second);
}

TEST_F(TlsTest, ACertificateThatIsGivenNeedsItsKey) {
  const TlsIdentity own = own_tls_identity(folder.path(), {"localhost"}, kNow);
  const TlsIdentity other = own_tls_identity(folder / "other", {"localhost"}, kNow);
  const auto certificate = private_file("a.crt", own.certificate_pem),
             key = private_file("a.key", own.key_pem);
  EXPECT_EQ(refusal(certificate, key), "read");
  EXPECT_THAT(refusal(certificate, private_file("b.key", other.key_pem)),
              HasSubstr("another key than that of"));
  EXPECT_THAT(refusal(certificate, private_file("c.key", "nothing")), HasSubstr("no private key"));
  EXPECT_THAT(refusal(private_file("c.crt", "nothing"), key), HasSubstr("no X.509 certificate"));
  ::chmod(key.c_str(), 0640);
  EXPECT_THAT(refusal(certificate, key), HasSubstr("chmod 600"));
}

/// One request over TLS, which checks the certificate and its name.
http::response<http::string_body> https_request(std::uint16_t port, const TlsIdentity& identity,
                                                http::request<http::string_body> request) {
  asio::io_context io;
  asio::ssl::context context(asio::ssl::context::tls_client);
  context.add_certificate_authority(asio::buffer(identity.certificate_pem));
  context.set_verify_mode(asio::ssl::verify_peer);
  context.set_verify_callback(asio::ssl::host_name_verification("127.0.0.1"));
  boost::beast::ssl_stream<boost::beast::tcp_stream> stream(io, context);
  stream.next_layer().socket().connect({asio::ip::address_v4::loopback(), port});
  stream.handshake(asio::ssl::stream_base::client);
  request.set(http::field::host, "127.0.0.1:" + std::to_string(port));
  request.prepare_payload();
  http::write(stream, request);
  boost::beast::flat_buffer buffer;
  http::response<http::string_body> response;
  http::read(stream, buffer, response);
  return response;
}

TEST_F(TlsTest, AllGoesThroughTlsAndTheCookieStaysThere) {
  options.tls = own_tls_identity(folder.path(), {"localhost", "127.0.0.1"}, kNow);
  options.access.token = "0123456789abcdef";
  open();
  const auto refused = https_request(port, *options.tls, {http::verb::get, "/runs", 11});
  EXPECT_EQ(refused.result_int(), 401U);
  EXPECT_EQ(refused[http::field::strict_transport_security], "max-age=31536000");
  http::request<http::string_body> form(http::verb::post, "/login", 11, "token=0123456789abcdef");
  form.set(http::field::origin, "https://127.0.0.1:" + std::to_string(port));
  const auto welcome = https_request(port, *options.tls, form);
  EXPECT_EQ(welcome.result_int(), 303U);
  const std::string cookie(welcome[http::field::set_cookie]);
  EXPECT_THAT(cookie, HasSubstr("; Secure"));
  http::request<http::string_body> runs(http::verb::get, "/runs", 11);
  runs.set(http::field::cookie, cookie.substr(0, cookie.find(';')));
  EXPECT_EQ(https_request(port, *options.tls, runs).result_int(), 200U);
  // Without TLS: no answer.
  EXPECT_EQ(test::http_get(port, "/").status, 0U);
  EXPECT_TRUE(is_logged("TLS: "));
}

}  // namespace
}  // namespace abcal::console
