// abcal-sign: adds the signature to a certificate. Started by abcal (app/certificate/sign.h), which so need
// not load the library for XML signatures.
#include <CLI/CLI.hpp>
#include <fstream>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>

#include "app/certificate/xml_signature.h"
#include "app/commands/run_program.h"
#include "app/system/output_file.h"

namespace {

void add_sign(CLI::App& parent) {
  struct Options {
    std::string xml, key, certificate, output;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("sign", "Add an enveloped XML signature to a document");
  command->add_option("XML", options->xml, "document without a signature")->required();
  command->add_option("KEY", options->key, "private key (PEM, without a passphrase)")->required();
  command->add_option("CERTIFICATE", options->certificate, "its X.509 certificate (PEM)")->required();
  command->add_option("OUTPUT", options->output, "file to write")->required();
  command->callback([options] {
    std::ifstream file(options->xml, std::ios::binary);
    std::ostringstream xml;
    xml << file.rdbuf();
    if (!file) throw std::runtime_error(options->xml + ": cannot be read");
    abcal::OutputFile(options->output)
        .write(abcal::add_xml_signature(xml.str(), {options->key, options->certificate}));
  });
}

}  // namespace

int main(int argc, char** argv) {
  return abcal::run_program(argc, argv,
                            {"abcal-sign", "abcal-sign adds the signatures of `abcal issue --sign`.",
                             [](CLI::App& app, int&) { add_sign(app); }});
}
