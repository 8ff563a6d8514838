# Builds for arm64 on another machine, with Debian's cross compiler and the libraries of Debian's multi-arch (packages :arm64).
# scripts/package --arch arm64 uses it; scripts/setup --arch arm64 installs what it needs.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_LIBRARY_ARCHITECTURE aarch64-linux-gnu)
set(CMAKE_C_COMPILER ${CMAKE_LIBRARY_ARCHITECTURE}-gcc)
set(CMAKE_CXX_COMPILER ${CMAKE_LIBRARY_ARCHITECTURE}-g++)
# Runs the program where a build needs what it prints (manual pages), and tests.
set(CMAKE_CROSSCOMPILING_EMULATOR /usr/bin/qemu-aarch64-static)
set(ENV{PKG_CONFIG_LIBDIR} /usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/pkgconfig:/usr/share/pkgconfig)
# Architecture in the names of the packages, and of the libraries that dpkg-shlibdeps looks for.
set(CPACK_DEBIAN_PACKAGE_ARCHITECTURE arm64)
