#pragma once

#include <filesystem>
#include <string>

namespace abcal {

/// The first characters of a file that are not blank, at most 4096; none if it has none, or is no file.
std::string beginning_of_file(const std::filesystem::path& path);

/// Whether a file begins as XML does.
bool looks_like_xml(const std::filesystem::path& path);

/// Refuses a file of another kind where a run is expected: a bench file or another TOML, XML such as a
/// certificate, JSON. Every other file is left to the reader of runs or CSV.
/// @param wanted  the files that the caller reads: "a run file (.run)"
/// @throws std::runtime_error that names the kind of the file, the required kind, and how to make one
void refuse_other_file(const std::filesystem::path& path, const char* wanted);

inline constexpr const char* kRunOrCsv = "a run file (.run) or a table of readings";
inline constexpr const char* kRunOnly = "a run file (.run)";

}  // namespace abcal
