// The functions of toml++, compiled once and into the program: its shared library alone would take 0.1 ms of
// every start.
#define TOML_IMPLEMENTATION
#include <toml++/toml.h>
