// Boost.URL, compiled into the program: Debian's package of the headers needs no library beside it.
#include <boost/url/src.hpp>
