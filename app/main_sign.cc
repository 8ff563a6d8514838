// abcal-sign: adds the signature to a certificate. Started by abcal (app/laboratory/certificate/sign.h), so
// that abcal need not load the library for XML signatures.
#include <CLI/CLI.hpp>
#include <memory>
#include <stdexcept>
#include <string>

#include "app/laboratory/certificate/xml_signature.h"
#include "app/run_program.h"
#include "app/system/output_file.h"
#include "app/system/read_file.h"

namespace {

void add_sign(CLI::App& parent) {
  struct Options {
    std::string xml, key, certificate, output, utc;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("sign", "Add an enveloped XML signature to a document");
  command->add_option("XML", options->xml, "document without a signature")->required();
  command->add_option("KEY", options->key, "private key (PEM, without a passphrase)")->required();
  command->add_option("CERTIFICATE", options->certificate, "its X.509 certificate (PEM)")->required();
  command->add_option("OUTPUT", options->output, "file to write")->required();
  command->add_option("--utc", options->utc, "time of signing, 2026-03-01T12:00:00.000Z")->required();
  command->callback([options] {
    abcal::OutputFile(options->output)
        .write(abcal::add_xml_signature(abcal::read_file(options->xml), {options->key, options->certificate},
                                        options->utc));
  });
}

void add_verify(CLI::App& parent) {
  struct Options {
    std::string xml, certificate;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = parent.add_subcommand("verify", "Verify the XML signature of a document");
  command->add_option("XML", options->xml, "signed document")->required();
  command->add_option("CERTIFICATE", options->certificate, "X.509 certificate of its key (PEM)")->required();
  command->callback([options] {
    if (!abcal::has_good_signature(abcal::read_file(options->xml), options->certificate))
      throw std::runtime_error(options->xml + ": the signature does not verify");
  });
}

}  // namespace

int main(int argc, char** argv) {
  return abcal::run_program(
      argc, argv,
      {"abcal-sign", "abcal-sign adds the signatures of `abcal issue --sign`.", [](CLI::App& app, int&) {
         add_sign(app);
         add_verify(app);
       }});
}
