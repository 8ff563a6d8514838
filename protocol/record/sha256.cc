#include "protocol/record/sha256.h"

#include <fmt/format.h>
#include <openssl/evp.h>

#include <array>
#include <fstream>

#include "protocol/record/sqlite.h"

namespace abcal {

Sha256::Sha256() : context_(EVP_MD_CTX_new()) {
  EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr);
}

void Sha256::FreeContext::operator()(evp_md_ctx_st* context) const {
  EVP_MD_CTX_free(context);
}

void Sha256::pass_on(std::string_view bytes) {
  EVP_DigestUpdate(context_.get(), gathered_.data(), count_);
  EVP_DigestUpdate(context_.get(), bytes.data(), bytes.size());
  count_ = 0;
}

std::string Sha256::hexadecimal() {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest{};
  unsigned length = 0;
  pass_on({});
  EVP_DigestFinal_ex(context_.get(), digest.data(), &length);
  std::string text;
  for (unsigned k = 0; k < length; ++k) text += fmt::format("{:02x}", digest.at(k));
  return text;
}

std::string sha256_of_file(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw RunFileError(path.string() + ": cannot be read to compute its hash");
  Sha256 hash;
  std::array<char, 1 << 16> buffer;
  while (file.read(buffer.data(), static_cast<std::streamsize>(buffer.size())), file.gcount() > 0)
    hash.add({buffer.data(), static_cast<std::size_t>(file.gcount())});
  return hash.hexadecimal();
}

std::string sha256_of(std::string_view bytes) {
  Sha256 hash;
  hash.add(bytes);
  return hash.hexadecimal();
}

std::string next_link(std::string_view previous, const std::vector<std::string>& fields) {
  Sha256 hash;
  hash.add(previous);
  for (const std::string& field : fields) {
    hash.add(fmt::format("\n{}:", field.size()));
    hash.add(field);
  }
  return hash.hexadecimal();
}

}  // namespace abcal
