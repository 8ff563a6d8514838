// The functions of toml++, compiled once and into the program: its shared library alone would take 0.1 ms of
// every start.
//
// A file with "[@]" is a mistake that the library reports. It asserts before that the character begins a key:
// the assertion would end the program, and from version 3.4 on be a promise to the optimiser.
#define TOML_ASSERT(expr) static_cast<void>(0)
#define TOML_ASSUME(expr) static_cast<void>(0)
#define TOML_IMPLEMENTATION
#include <toml++/toml.h>
