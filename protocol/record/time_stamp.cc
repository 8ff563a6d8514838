#include "protocol/record/time_stamp.h"

#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/rand.h>
#include <openssl/ts.h>
#include <openssl/x509_vfy.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <ctime>
#include <stdexcept>
#include <vector>

#include "protocol/record/openssl_parts.h"

namespace abcal {
namespace {

using Request = std::unique_ptr<TS_REQ, OpensslFree<TS_REQ_free>>;
using Answer = std::unique_ptr<TS_RESP, OpensslFree<TS_RESP_free>>;
using Imprint = std::unique_ptr<TS_MSG_IMPRINT, OpensslFree<TS_MSG_IMPRINT_free>>;
using Algorithm = std::unique_ptr<X509_ALGOR, OpensslFree<X509_ALGOR_free>>;
using Integer = std::unique_ptr<ASN1_INTEGER, OpensslFree<ASN1_INTEGER_free>>;
using Token = std::unique_ptr<PKCS7, OpensslFree<PKCS7_free>>;
using Info = std::unique_ptr<TS_TST_INFO, OpensslFree<TS_TST_INFO_free>>;
using Verification = std::unique_ptr<TS_VERIFY_CTX, OpensslFree<TS_VERIFY_CTX_free>>;

std::vector<unsigned char> bytes_of(std::string_view hexadecimal) {
  std::vector<unsigned char> bytes;
  for (std::size_t at = 0; at + 1 < hexadecimal.size(); at += 2) {
    unsigned value = 0;
    const char* begin = hexadecimal.data() + at;
    if (std::from_chars(begin, begin + 2, value, 16).ptr != begin + 2)
      throw std::invalid_argument("a SHA-256 that is not hexadecimal");
    bytes.push_back(static_cast<unsigned char>(value));
  }
  if (bytes.size() != 32) throw std::invalid_argument("a SHA-256 that does not have 32 bytes");
  return bytes;
}

template <class Part, class Read>
Part parse_der(std::string_view der, Read read) {
  const auto* at = reinterpret_cast<const unsigned char*>(der.data());
  return Part(read(nullptr, &at, static_cast<long>(der.size())));
}

std::string last_openssl_error() {
  std::array<char, 256> text{};
  const unsigned long code = ERR_peek_last_error();
  ERR_error_string_n(code, text.data(), text.size());
  ERR_clear_error();
  return code == 0 ? "no reason given" : text.data();
}

std::string name_of(TS_TST_INFO* info, PKCS7* token) {
  (void)info;
  STACK_OF(X509)* signers = PKCS7_get0_signers(token, nullptr, 0);
  std::string name;
  if (signers != nullptr && sk_X509_num(signers) > 0) {
    const OpensslBio words = writable();
    X509_NAME_print_ex(words.get(), X509_get_subject_name(sk_X509_value(signers, 0)), 0, XN_FLAG_ONELINE);
    name = written(words);
  }
  sk_X509_free(signers);
  ERR_clear_error();
  return name;
}

std::string utc_of(TS_TST_INFO* info) {
  std::tm time{};
  if (ASN1_TIME_to_tm(TS_TST_INFO_get_time(info), &time) != 1) return {};
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", &time);
  return text.data();
}

X509_STORE* store_of(const std::string& trusted_pem) {
  X509_STORE* store = X509_STORE_new();
  const OpensslBio pem = readable(trusted_pem);
  while (X509* certificate = PEM_read_bio_X509(pem.get(), nullptr, nullptr, nullptr)) {
    X509_STORE_add_cert(store, certificate);
    X509_free(certificate);
  }
  ERR_clear_error();  // The end of the certificates is an error to OpenSSL.
  return store;
}

}  // namespace

std::string time_stamp_request(std::string_view sha256) {
  std::vector<unsigned char> hash = bytes_of(sha256);
  const Request request(TS_REQ_new());
  const Imprint imprint(TS_MSG_IMPRINT_new());
  const Algorithm algorithm(X509_ALGOR_new());
  const Integer nonce(ASN1_INTEGER_new());
  std::uint64_t random = 0;
  if (RAND_bytes(reinterpret_cast<unsigned char*>(&random), sizeof random) != 1 ||
      ASN1_INTEGER_set_uint64(nonce.get(), random) != 1 ||
      X509_ALGOR_set0(algorithm.get(), OBJ_nid2obj(NID_sha256), V_ASN1_NULL, nullptr) != 1 ||
      TS_MSG_IMPRINT_set_algo(imprint.get(), algorithm.get()) != 1 ||
      TS_MSG_IMPRINT_set_msg(imprint.get(), hash.data(), static_cast<int>(hash.size())) != 1 ||
      TS_REQ_set_version(request.get(), 1) != 1 ||
      TS_REQ_set_msg_imprint(request.get(), imprint.get()) != 1 ||
      TS_REQ_set_nonce(request.get(), nonce.get()) != 1 || TS_REQ_set_cert_req(request.get(), 1) != 1)
    throw std::runtime_error("a request for a time stamp could not be made");
  const OpensslBio der = writable();
  i2d_TS_REQ_bio(der.get(), request.get());
  return written(der);
}

TimeStampAnswer read_time_stamp_answer(std::string_view answer, std::string_view request) {
  const auto response = parse_der<Answer>(answer, d2i_TS_RESP);
  const auto asked = parse_der<Request>(request, d2i_TS_REQ);
  if (!response || !asked) {
    ERR_clear_error();
    return {{}, "the answer does not follow RFC 3161"};
  }
  const TS_STATUS_INFO* status = TS_RESP_get_status_info(response.get());
  if (const long code = ASN1_INTEGER_get(TS_STATUS_INFO_get0_status(status)); code != 0 && code != 1)
    return {{}, "the authority refuses (status " + std::to_string(code) + ")"};
  // Checks the parts that the request determines: the hash and the random number. The signature is checked on
  // verification.
  const Verification check(TS_REQ_to_TS_VERIFY_CTX(asked.get(), nullptr));
  TS_VERIFY_CTX_set_flags(check.get(), TS_VFY_VERSION | TS_VFY_IMPRINT | TS_VFY_NONCE);
  if (TS_RESP_verify_response(check.get(), response.get()) != 1)
    return {{}, "the answer does not belong to the request: " + last_openssl_error()};
  PKCS7* token = TS_RESP_get_token(response.get());
  unsigned char* der = nullptr;
  const int size = i2d_PKCS7(token, &der);
  TimeStampAnswer good{std::string(reinterpret_cast<const char*>(der), static_cast<std::size_t>(size)), {}};
  OPENSSL_free(der);
  return good;
}

TimeStampCheck check_time_stamp(std::string_view token_der, std::string_view sha256,
                                const std::string& trusted_pem) {
  const auto token = parse_der<Token>(token_der, d2i_PKCS7);
  TimeStampCheck result;
  const Info info(token ? PKCS7_to_TS_TST_INFO(token.get()) : nullptr);
  if (!info) {
    result.found = "it is not a time stamp according to RFC 3161";
    ERR_clear_error();
    return result;
  }
  result.utc = utc_of(info.get());
  result.authority = name_of(info.get(), token.get());
  const ASN1_OCTET_STRING* stamped = TS_MSG_IMPRINT_get_msg(TS_TST_INFO_get_msg_imprint(info.get()));
  const std::vector<unsigned char> expected = bytes_of(sha256);
  result.for_this_hash = std::equal(expected.begin(), expected.end(), ASN1_STRING_get0_data(stamped),
                                    ASN1_STRING_get0_data(stamped) + ASN1_STRING_length(stamped));
  const Verification check(TS_VERIFY_CTX_new());
  TS_VERIFY_CTX_set_flags(check.get(), TS_VFY_VERSION | TS_VFY_IMPRINT | TS_VFY_SIGNATURE);
  auto* imprint = static_cast<unsigned char*>(OPENSSL_memdup(expected.data(), expected.size()));
  // Both set functions take ownership of their arguments.
  const auto imprint_size = static_cast<long>(expected.size());
#if OPENSSL_VERSION_NUMBER >= 0x30400000L
  TS_VERIFY_CTX_set0_imprint(check.get(), imprint, imprint_size);
  TS_VERIFY_CTX_set0_store(check.get(), store_of(trusted_pem));
#else
  TS_VERIFY_CTX_set_imprint(check.get(), imprint, imprint_size);
  TS_VERIFY_CTX_set_store(check.get(), store_of(trusted_pem));
#endif
  result.good = TS_RESP_verify_token(check.get(), token.get()) == 1;
  if (!result.good) result.found = last_openssl_error();
  return result;
}

}  // namespace abcal
