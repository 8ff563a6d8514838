# Functions that only Linux (with glibc 2.34 or later) has, and the files that use them. Elsewhere the configuration ends here
# and lists the functions to be replaced, so that the build does not fail in its middle.
include(CheckCXXSymbolExists)

# symbol | header | file that uses it: purpose
set(linux_parts
  "renameat2|cstdio|protocol/record/run_file.cc: a run file takes its name only if nothing else has it"
  "inotify_init1|sys/inotify.h|sim/emulator.cc: whether a program has an emulated port open"
  "major|sys/sysmacros.h|drivers/wire/serial_port.cc: pseudo-terminals are told from real ports"
  "USBTMC_IOCTL_CLEAR|linux/usb/tmc.h|drivers/wire/usbtmc_stream.cc: voltmeters on USB"
  "posix_spawn_file_actions_addclosefrom_np|spawn.h|app/system/child_process.cc: no port is inherited by another program")

set(missing_parts)
foreach(part IN LISTS linux_parts)
  string(REPLACE "|" ";" part "${part}")
  list(GET part 0 symbol)
  list(GET part 1 header)
  list(GET part 2 use)
  if(header STREQUAL "linux/usb/tmc.h")
    set(header "sys/ioctl.h;linux/usb/tmc.h")
  endif()
  check_cxx_symbol_exists(${symbol} "${header}" ABCAL_HAS_${symbol})
  if(NOT ABCAL_HAS_${symbol})
    string(APPEND missing_parts "\n  ${symbol} (${use})")
  endif()
endforeach()
if(missing_parts)
  message(FATAL_ERROR "abcal is made for Linux; required and not found on this ${CMAKE_SYSTEM_NAME}:${missing_parts}")
endif()
