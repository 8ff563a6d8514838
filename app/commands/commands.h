#pragma once

#include <CLI/CLI.hpp>

namespace abcal {

// Each adds one command to the program. Its callback carries the command out and sets `exit_code`
// (app/system/exit_code.h); errors that it does not handle itself are for main().

CLI::App* add_init(CLI::App& parent, int& exit_code);
CLI::App* add_run(CLI::App& parent, int& exit_code);
CLI::App* add_resume(CLI::App& parent, int& exit_code);
CLI::App* add_record(CLI::App& parent, int& exit_code);
CLI::App* add_replay(CLI::App& parent, int& exit_code);
CLI::App* add_plan(CLI::App& parent, int& exit_code);
CLI::App* add_check(CLI::App& parent, int& exit_code);
CLI::App* add_analyse(CLI::App& parent, int& exit_code);
CLI::App* add_combine(CLI::App& parent, int& exit_code);
CLI::App* add_report(CLI::App& parent, int& exit_code);
CLI::App* add_issue(CLI::App& parent, int& exit_code);
CLI::App* add_lab(CLI::App& parent, int& exit_code);
CLI::App* add_verify(CLI::App& parent, int& exit_code);
CLI::App* add_temperature(CLI::App& parent, int& exit_code);
CLI::App* add_level(CLI::App& parent, int& exit_code);
CLI::App* add_apply(CLI::App& parent, int& exit_code);
CLI::App* add_export(CLI::App& parent, int& exit_code);
CLI::App* add_emulate(CLI::App& parent, int& exit_code);
CLI::App* add_demo(CLI::App& parent, int& exit_code);
CLI::App* add_docs(CLI::App& parent, int& exit_code);
CLI::App* add_compare(CLI::App& parent, int& exit_code);
CLI::App* add_pilot(CLI::App& parent, int& exit_code);
CLI::App* add_stage(CLI::App& parent, int& exit_code);
CLI::App* add_mountings(CLI::App& parent, int& exit_code);
CLI::App* add_gravity(CLI::App& parent, int& exit_code);
CLI::App* add_serve(CLI::App& parent, int& exit_code);
CLI::App* add_instruments(CLI::App& parent, int& exit_code);
CLI::App* add_self_test(CLI::App& parent, int& exit_code);

}  // namespace abcal
