#include "app/commands/certificate_options.h"

#include "app/laboratory/certificate/words.h"

namespace abcal {

void add_certificate_options(CLI::App& command, CertificateFiles& files) {
  command.add_option(
      "--laboratory", files.laboratory,
      "laboratory file (docs/examples/laboratory.toml): laboratory, customer, equipment, limits");
  command.add_option("--as-found", files.as_found, "run of the same item before its adjustment");
  command.add_option(
      "--temperature", files.temperature,
      "runs of a series over temperature of the same item on the same bench: every point, behind RUN");
  command.add_option("--schemas", files.schemas,
                     "folder with schemas (v3.3.0/dcc.xsd) to be used instead of the program's own");
  command
      .add_option("--language", files.language,
                  "language of the certificate (default: the laboratory file's)")
      ->check(CLI::IsMember(Words::languages()));
}

}  // namespace abcal
