// Runs that are signed by their bench and stamped by an authority.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <cstdlib>
#include <thread>

#include "protocol/record/attestation.h"
#include "protocol/record/run_seal.h"
#include "protocol/record/signature.h"
#include "protocol/record/time_stamp.h"
#include "tests/app/witness/evidence_fixtures.h"

namespace abcal {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class SealTest : public EvidenceTest {
 protected:
  bool shell(const std::string& command) const {
    return std::system(("cd '" + folder.path().string() + "' && { " + command + "; } > log 2>&1").c_str()) ==
           0;
  }

  /// Signs the closed run as version 1.0 did, with the key of "bench 1".
  void sign_as_version_1_0(const std::string& private_pem) const {
    SqliteDatabase database(results(), SqliteDatabase::Mode::kReadWrite);
    if (!database.value("select signer from run").value_or("").empty()) return;
    const std::string sha256 = database.value("select sha256 from run").value_or("");
    SqliteStatement row = database.prepare("update run set signer = :signer, signature = :signature");
    row.set("signer", std::string_view("bench 1\n" + public_key_of(private_pem)));
    row.bind_blob(2, sign(statement_of_run(sha256), private_pem)).run();
  }

  /// An authority of the test's own: ca.pem, and what `openssl ts` answers with.
  void make_authority() const {
    test::write_file(folder / "tsa.cnf", R"([tsa]
default_tsa = one
[one]
dir = .
serial = ./serial
signer_cert = ./tsa.pem
certs = ./ca.pem
signer_key = ./tsa.key
signer_digest = sha256
default_policy = 1.2.3.4.1
digests = sha256
accuracy = secs:1
[ext]
extendedKeyUsage = critical,timeStamping
)");
    test::write_file(folder / "serial", "01\n");
    ASSERT_TRUE(shell(
        "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -keyout ca.key -out ca.pem "
        "-days 30 "
        "-subj '/CN=Root of the test'"
        " && openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -keyout tsa.key -out tsa.csr "
        "-subj '/CN=Authority of the test'"
        " && openssl x509 -req -in tsa.csr -CA ca.pem -CAkey ca.key -CAcreateserial -out tsa.pem -days 30 "
        "-extfile tsa.cnf -extensions ext"))
        << test::read_file(folder / "log");
  }

  test::ProgramResult verify(std::vector<std::string> more) {
    more.insert(more.begin(), {"verify", path.filename().string()});
    return abcal(more);
  }

  /// The authority on a port of this machine, for the lifetime of this object.
  class Server {
   public:
    explicit Server(const SealTest& test)
        : acceptor_(context_, {boost::asio::ip::make_address("127.0.0.1"), 0}),
          thread_([this, &test] { serve(test); }) {}
    Server(const Server&) = delete;
    Server& operator=(const Server&) = delete;
    ~Server() {
      ::shutdown(acceptor_.native_handle(), SHUT_RDWR);  // Wakes the thread that waits in accept().
      thread_.join();
    }
    std::string address() const {
      return "http://127.0.0.1:" + std::to_string(acceptor_.local_endpoint().port()) + "/tsr";
    }

   private:
    void serve(const SealTest& test) {
      namespace http = boost::beast::http;
      for (;;) {
        boost::system::error_code error;
        boost::asio::ip::tcp::socket socket(context_);
        acceptor_.accept(socket, error);
        if (error) return;
        boost::beast::flat_buffer buffer;
        http::request<http::string_body> request;
        http::read(socket, buffer, request, error);
        if (error) continue;
        test::write_file(test.folder / "http.tsq", request.body());
        const bool made =
            std::system(("cd '" + test.folder.path().string() +
                         "' && openssl ts -reply -config tsa.cnf -section one -queryfile http.tsq "
                         "-out http.tsr 2> http.log")
                            .c_str()) == 0;
        http::response<http::string_body> answer(
            made ? http::status::ok : http::status::internal_server_error, 11,
            test::read_file(test.folder / "http.tsr"));
        answer.prepare_payload();
        http::write(socket, answer, error);
      }
    }
    boost::asio::io_context context_;
    boost::asio::ip::tcp::acceptor acceptor_;
    std::thread thread_;
  };

  const std::string key = make_private_key();
  Trust trust() const { return {{{"bench 1", public_key_of(key)}}, {}}; }
};

TEST_F(SealTest, ASignatureIsThatOfItsKeyAndMessage) {
  const std::string other = make_private_key();
  const std::string signature = sign("message", key);
  EXPECT_EQ(signature.size(), 64U);
  EXPECT_TRUE(is_signature("message", signature, public_key_of(key)));
  EXPECT_FALSE(is_signature("Message", signature, public_key_of(key)));
  EXPECT_FALSE(is_signature("message", signature, public_key_of(other)));
  EXPECT_FALSE(is_signature("message", signature, "no key"));
  EXPECT_NE(fingerprint_of(public_key_of(key)), fingerprint_of(public_key_of(other)));
  EXPECT_THROW((void)sign("message", public_key_of(key)), std::invalid_argument);
}

TEST_F(SealTest, OpensslVerifiesTheSignature) {
  if (!shell("command -v openssl")) GTEST_SKIP() << "openssl is not installed";
  sign_as_version_1_0(key);
  test::write_file(folder / "bench.pub", public_key_of(key));
  test::write_file(folder / "message", statement_of_run(sha256_of_file(path)));
  test::write_file(folder / "signature", read_seal(path).signature);
  EXPECT_TRUE(shell("openssl pkeyutl -verify -pubin -inkey bench.pub -rawin -in message -sigfile signature"))
      << test::read_file(folder / "log");
}

TEST_F(SealTest, ARunIsSignedWhenItIsClosedAndAKeyThatOthersCanReadIsRefused) {
  test::write_file(folder / "bench.pem", key);
  test::write_file(folder / "bench.pub", public_key_of(key));
  test::write_file(folder / "bench.toml", certificate_bench());
  ::setenv("ABCAL_SIGNING_KEY", (folder / "bench.pem").c_str(), 1);
  ::setenv("XDG_STATE_HOME", (folder / "state").c_str(), 1);
  std::filesystem::permissions(folder / "bench.pem", std::filesystem::perms(0644));
  const auto refused = abcal({"run", "bench.toml", "-o", "signed.run"});
  std::filesystem::permissions(folder / "bench.pem", std::filesystem::perms(0600));
  const auto made = abcal({"run", "bench.toml", "-o", "signed.run"});
  ::unsetenv("ABCAL_SIGNING_KEY");
  ::unsetenv("XDG_STATE_HOME");
  EXPECT_EQ(refused.exit_code, 2);
  EXPECT_THAT(refused.err, HasSubstr("chmod 600"));
  ASSERT_EQ(made.exit_code, 0) << made.err;
  const auto verified = abcal({"verify", "signed.run", "--require", "signed", "--key", "bench.pub"});
  EXPECT_EQ(verified.exit_code, 0) << verified.out << verified.err;
  EXPECT_THAT(
      verified.out,
      HasSubstr("a run with simulated time on bench 1; beginning and end signed by the key of bench.pub"));
}

TEST_F(SealTest, WhatWasForgedByHandIsSelfConsistentButNotSigned) {
  sign_as_version_1_0(key);
  EXPECT_TRUE(attest(path, trust()).is_signed);
  forge(kLargerU);
  const Attestation forged = attest(path, trust());
  EXPECT_FALSE(forged.is_signed);
  ASSERT_EQ(forged.checks.size(), 1U);
  EXPECT_FALSE(forged.checks[0].good);

  // Without the signature the forgery cannot be distinguished from a run, and the output says so.
  SqliteDatabase(results(), SqliteDatabase::Mode::kReadWrite)
      .execute("update run set signer = null, signature = null");
  test::write_file(folder / "bench.pub", public_key_of(key));
  const auto alone = verify({});
  EXPECT_EQ(alone.exit_code, 0) << alone.out;
  EXPECT_THAT(alone.out, HasSubstr("neither a signature nor a time stamp"));
  EXPECT_EQ(verify({"--require", "signed", "--key", "bench.pub"}).exit_code, 1);

  // A signature by another key does not help, either.
  sign_as_version_1_0(make_private_key());
  const auto other = verify({"--require", "signed", "--key", "bench.pub"});
  EXPECT_EQ(other.exit_code, 1);
  EXPECT_THAT(other.out, HasSubstr("not one of the trusted keys"));
}

TEST_F(SealTest, ATimeStampHoldsForTheBytesThatWereStamped) {
  if (!shell("command -v openssl")) GTEST_SKIP() << "openssl is not installed";
  make_authority();
  const std::string run = path.filename().string();
  ASSERT_EQ(abcal({"lab", "timestamp", run, "--query", "q.tsq"}).exit_code, 0);
  ASSERT_TRUE(shell("openssl ts -reply -config tsa.cnf -section one -queryfile q.tsq -out a.tsr"))
      << test::read_file(folder / "log");
  const auto kept = abcal({"lab", "timestamp", run, "--query", "q.tsq", "--answer", "a.tsr"});
  ASSERT_EQ(kept.exit_code, 0) << kept.err;
  EXPECT_THAT(kept.out, HasSubstr("Authority of the test"));
  EXPECT_THAT(abcal({"lab", "timestamp", run, "--query", "q.tsq", "--answer", "a.tsr"}).out,
              HasSubstr("already"));
  const auto verified = verify({"--require", "timestamped", "--authority", "ca.pem"});
  EXPECT_EQ(verified.exit_code, 0) << verified.out;
  EXPECT_THAT(verified.out, HasSubstr("unchanged since 20"));
  EXPECT_THAT(verify({}).out, HasSubstr("the authority was not checked"));

  forge(kLargerU);
  EXPECT_EQ(verify({"--require", "timestamped", "--authority", "ca.pem"}).exit_code, 1);
  EXPECT_THAT(verify({}).out, HasSubstr("it is not for the present content of the run"));
}

// Anyone who can write every file has neither the bench's key nor an earlier stamp of the authority.
TEST_F(SealTest, WithSignatureAndTimeStampALaterChangeOfEveryFileIsFound) {
  if (!shell("command -v openssl")) GTEST_SKIP() << "openssl is not installed";
  make_authority();
  test::write_file(folder / "bench.pub", public_key_of(key));
  const std::string run = path.filename().string();
  const auto stamp = [&] {
    ASSERT_EQ(abcal({"lab", "timestamp", run, "--query", "q.tsq"}).exit_code, 0);
    ASSERT_TRUE(shell("openssl ts -reply -config tsa.cnf -section one -queryfile q.tsq -out a.tsr"));
    ASSERT_EQ(abcal({"lab", "timestamp", run, "--query", "q.tsq", "--answer", "a.tsr"}).exit_code, 0);
  };
  const std::vector<std::string> both{"--require", "signed",      "--key",       "bench.pub",
                                      "--require", "timestamped", "--authority", "ca.pem"};
  sign_as_version_1_0(key);
  stamp();
  const auto good = verify(both);
  ASSERT_EQ(good.exit_code, 0) << good.out;
  EXPECT_THAT(good.out, AllOf(HasSubstr("signed by the key of bench 1"), HasSubstr("unchanged since 20")));

  // Readings, means, chains, seal, hashes and analyses are made again, so that the run agrees with itself.
  forge(kLargerU);
  EXPECT_EQ(abcal({"analyse", run}).exit_code, 0);
  EXPECT_EQ(verify(both).exit_code, 1);  // Signature and stamp are of the run as it was.
  SqliteDatabase(results(), SqliteDatabase::Mode::kReadWrite)
      .execute("update run set signer = null, signature = null, time_stamp = null");
  EXPECT_EQ(verify({}).exit_code, 0);  // Agrees with itself: without the two nothing shows it.
  EXPECT_EQ(verify(both).exit_code, 1);
  // Signed by another key, and stamped again by the same authority.
  sign_as_version_1_0(make_private_key());
  stamp();
  const auto other = verify(both);
  EXPECT_EQ(other.exit_code, 1);
  EXPECT_THAT(other.out, HasSubstr("not one of the trusted keys"));
}

TEST_F(SealTest, AnAnswerThatIsNotForTheRequestIsRefused) {
  if (!shell("command -v openssl")) GTEST_SKIP() << "openssl is not installed";
  make_authority();
  const std::string run = path.filename().string();
  ASSERT_EQ(abcal({"lab", "timestamp", run, "--query", "q.tsq"}).exit_code, 0);
  ASSERT_EQ(abcal({"lab", "timestamp", run, "--query", "other.tsq"}).exit_code, 0);  // Another random number.
  ASSERT_TRUE(shell("openssl ts -reply -config tsa.cnf -section one -queryfile other.tsq -out a.tsr"));
  const auto refused = abcal({"lab", "timestamp", run, "--query", "q.tsq", "--answer", "a.tsr"});
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_THAT(refused.err, HasSubstr("does not belong to the request"));
  test::write_file(folder / "a.tsr", "no answer");
  EXPECT_THAT(abcal({"lab", "timestamp", run, "--query", "q.tsq", "--answer", "a.tsr"}).err,
              HasSubstr("RFC 3161"));
}

TEST_F(SealTest, AnAuthorityThatDoesNotAnswerLosesNothing) {
  const std::string before = sha256_of_file(results());
  // Nothing listens on the port that is reserved for multiplexing (RFC 1078).
  const auto unanswered =
      abcal({"lab", "timestamp", path.filename().string(), "--authority", "http://127.0.0.1:1/tsr"});
  EXPECT_EQ(unanswered.exit_code, 1);
  EXPECT_THAT(unanswered.err, HasSubstr("does not answer"));
  {
    const Server server(*this);  // It has no keys yet, so that it cannot stamp.
    const auto refused =
        abcal({"lab", "timestamp", path.filename().string(), "--authority", server.address()});
    EXPECT_EQ(refused.exit_code, 1);
    EXPECT_THAT(refused.err, HasSubstr("time stamp: " + server.address() + " answers 500"));
  }
  EXPECT_EQ(sha256_of_file(results()), before);
  for (const char* address : {"ftp://x", "https://x/", "no address", "http://", "http://x:port/"}) {
    const auto unusable = abcal({"lab", "timestamp", path.filename().string(), "--authority", address});
    EXPECT_EQ(unusable.exit_code, 2) << address;
    EXPECT_THAT(unusable.err, HasSubstr("required: http://HOST[:PORT][/PATH]")) << address;
  }
}

TEST_F(SealTest, ARunAsksForItsTimeStampAndIsNotLostWithoutOne) {
  if (!shell("command -v openssl")) GTEST_SKIP() << "openssl is not installed";
  make_authority();
  test::write_file(folder / "bench.toml", certificate_bench());
  const std::vector<std::string> require{"--require", "timestamped", "--authority", "ca.pem"};
  const auto is_stamped = [&](const std::string& run) {
    return abcal({"verify", run, require[0], require[1], require[2], require[3]}).exit_code == 0;
  };
  ::setenv("ABCAL_TIME_STAMP_AUTHORITY", "http://127.0.0.1:1/tsr", 1);
  const auto late = abcal({"run", "bench.toml", "-o", "late.run"});
  EXPECT_EQ(late.exit_code, 0) << late.err;
  EXPECT_THAT(late.err, AllOf(HasSubstr("late.run has no time stamp yet"), HasSubstr("does not answer"),
                              HasSubstr("abcal lab timestamp late.run")));
  EXPECT_FALSE(is_stamped("late.run"));
  {
    const Server server(*this);
    ::setenv("ABCAL_TIME_STAMP_AUTHORITY", server.address().c_str(), 1);
    const auto made = abcal({"run", "bench.toml", "-o", "stamped.run"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
    EXPECT_TRUE(is_stamped("stamped.run")) << made.err;
    const auto again = abcal({"lab", "timestamp", "late.run"});
    EXPECT_EQ(again.exit_code, 0) << again.err;
    EXPECT_THAT(again.out, HasSubstr("Authority of the test"));
  }
  ::unsetenv("ABCAL_TIME_STAMP_AUTHORITY");
  EXPECT_TRUE(is_stamped("late.run"));
}

}  // namespace
}  // namespace abcal
