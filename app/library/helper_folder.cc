#include "app/library/helper_folder.h"

#include <dlfcn.h>

#include <filesystem>
#include <mutex>

#include "app/system/helper_program.h"

namespace abcal::v1 {

void find_helpers() {
  static std::once_flag once;
  std::call_once(once, [] {
    Dl_info info{};
    if (dladdr(reinterpret_cast<const void*>(&find_helpers), &info) == 0 || info.dli_fname == nullptr) return;
    std::error_code error;
    const std::filesystem::path own = std::filesystem::canonical(info.dli_fname, error);
    if (error) return;
    // In a build they are in the library's folder; installed, PREFIX/lib/TRIPLET is two folders below the
    // prefix.
    std::filesystem::path folder = own.parent_path();
    if (std::filesystem::exists(folder / "abcal-guard", error)) {
      ::abcal::set_helper_folder(folder);
      return;
    }
    for (; folder != folder.root_path(); folder = folder.parent_path()) {
      if (!std::filesystem::exists(folder / "libexec/abcal", error)) continue;
      ::abcal::set_helper_folder(folder / "bin");
      return;
    }
  });
}

}  // namespace abcal::v1
