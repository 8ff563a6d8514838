#pragma once

#include <filesystem>
#include <optional>
#include <string>

namespace abcal::lab {

/// The file in which `abcal lab login` stores the person logged in to a register on this machine: in
/// $XDG_STATE_HOME/abcal (default ~/.local/state/abcal), readable by its user only.
struct LoginFile {
  std::string register_identity;
  std::string token;
};

/// Folder for this program's data of its user on this machine: $XDG_STATE_HOME/abcal, else
/// ~/.local/state/abcal. @throws std::runtime_error if the environment names neither
std::filesystem::path state_folder();

/// Where the login to a register is kept.
std::filesystem::path login_file_path(const std::string& register_identity);

/// Keeps a login. @throws std::runtime_error
void write_login(const LoginFile& login);

/// The login to a register, or nothing. @throws std::runtime_error if others can read the file
std::optional<LoginFile> read_login(const std::string& register_identity);

/// Forgets the login to a register.
void remove_login(const std::string& register_identity);

}  // namespace abcal::lab
