#include "app/commands/certificate_options.h"

#include "app/system/output.h"

namespace abcal {

void add_certificate_options(CLI::App& command, CertificateFiles& files) {
  command.add_option(
      "--laboratory", files.laboratory,
      "laboratory file (docs/examples/laboratory.toml): laboratory, customer, equipment, limits");
  command.add_option("--as-found", files.as_found, "run of the same item before its adjustment");
  command.add_option("--schemas", files.schemas,
                     "folder with the schemas of the certificate (v3.3.0/dcc.xsd): validate it");
}

void print_note(const std::string& note) {
  if (!note.empty()) print_log("note: {}\n", note);
}

}  // namespace abcal
