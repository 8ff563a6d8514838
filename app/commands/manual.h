#pragma once

#include <CLI/CLI.hpp>
#include <map>
#include <string>

namespace abcal {

/// Manual pages (troff, section 1) from the command line's own tree: "abcal.1" and one for each command,
/// "abcal-run.1". Options hidden from --help are omitted.
/// @param version  "abcal 1.0.0"
/// @param date     for the pages' foot; empty: none
std::map<std::string, std::string> manual_pages(const CLI::App& app, const std::string& version,
                                                const std::string& date);

/// Completion of commands, options, choices and files, from the same tree.
std::string bash_completion(const CLI::App& app);
std::string zsh_completion(const CLI::App& app);

/// The hidden option --write-manual DIR, which the build uses: writes all of the above into a folder. The
/// date is that of SOURCE_DATE_EPOCH, if it is set, so that a build can be repeated bit for bit.
void add_manual_option(CLI::App& app, const std::string& version);

}  // namespace abcal
