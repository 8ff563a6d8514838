#pragma once

#include <openssl/bio.h>
#include <openssl/evp.h>

#include <memory>
#include <string>
#include <string_view>

namespace abcal {

/// Frees objects made by OpenSSL.
template <auto Free>
struct OpensslFree {
  template <class Part>
  void operator()(Part* part) const {
    Free(part);
  }
};

using OpensslKey = std::unique_ptr<EVP_PKEY, OpensslFree<EVP_PKEY_free>>;
using OpensslBio = std::unique_ptr<BIO, OpensslFree<BIO_free>>;

/// Memory to read from; it must outlive the result.
inline OpensslBio readable(std::string_view bytes) {
  return OpensslBio(BIO_new_mem_buf(bytes.data(), static_cast<int>(bytes.size())));
}

/// A memory buffer for writing, and its content.
inline OpensslBio writable() {
  return OpensslBio(BIO_new(BIO_s_mem()));
}
inline std::string written(const OpensslBio& bio) {
  char* bytes = nullptr;
  const long size = BIO_get_mem_data(bio.get(), &bytes);
  return size > 0 ? std::string(bytes, static_cast<std::size_t>(size)) : std::string();
}

}  // namespace abcal
