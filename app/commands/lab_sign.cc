#include "app/commands/lab.h"
#include "app/laboratory/certificate/sign.h"
#include "app/system/exit_code.h"
#include "app/system/output.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"
#include "app/system/real_clock.h"
#include "protocol/record/run_file.h"

namespace abcal {

void add_lab_sign(CLI::App& parent, int& exit_code) {
  struct SignOptions {
    std::string xml, key, certificate, output;
    bool force = false;
  };
  auto options = std::make_shared<SignOptions>();
  CLI::App* command = parent.add_subcommand(
      "sign",
      "Sign a certificate that waits for its approver's signature on the console's page; needs no register");
  command->add_option("XML", options->xml, "certificate that was downloaded from the page")->required();
  command->add_option("--sign", options->key, "private key of the approver (PEM)")->required();
  command->add_option("--certificate", options->certificate, "X.509 certificate of that key (PEM)")
      ->required();
  command->add_option("-o,--output", options->output, "signed certificate, to be handed in on the page")
      ->required();
  command->add_flag("--force", options->force, "overwrite a file that exists");
  command->callback([options, &exit_code] {
    require_writable({{"--output", options->output}}, {options->xml, options->key, options->certificate},
                     options->force);
    OutputFile(options->output)
        .write(sign_xml(read_file(options->xml), {options->key, options->certificate},
                        format_utc(RealClock().utc_now())));
    print_result("signed: {}\n", options->output);
    exit_code = kExitDone;
  });
}

}  // namespace abcal
