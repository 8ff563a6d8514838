#pragma once

#include <filesystem>

namespace abcal {

/// Folder for the logs of this user: STATE_DIRECTORY of a service, otherwise XDG_STATE_HOME/abcal or
/// ~/.local/state/abcal. Empty: none of them is known.
std::filesystem::path state_folder();

}  // namespace abcal
