#pragma once

#include <filesystem>

namespace abcal {

/// Whether a file begins as XML does.
bool looks_like_xml(const std::filesystem::path& path);

/// Refuses what is given by mistake where a run is expected: a bench file or another TOML, XML such as a
/// certificate, JSON. What is none of them is left to the reader of runs or CSV.
/// @param wanted  what the caller reads: "a run file (.run)"
/// @throws std::runtime_error  what the file is, what is required, and what makes it
void refuse_other_file(const std::filesystem::path& path, const char* wanted);

inline constexpr const char* kRunOrCsv = "a run file (.run) or averaged readings as CSV";
inline constexpr const char* kRunOnly = "a run file (.run)";

}  // namespace abcal
